"""Experiments as data, and the documents made from their results."""
