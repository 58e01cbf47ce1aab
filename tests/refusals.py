"""What a command that is refused says."""


def clear(err):
    """Whether stderr holds one line of ours, or what tyro says of an option, which ends with where the help is."""
    return "Traceback" not in err and (len(err.splitlines()) == 1 or "--help" in err)
