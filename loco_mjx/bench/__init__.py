"""How fast each part of the program is on this machine, where there is one beside a peer on the same scenes."""
