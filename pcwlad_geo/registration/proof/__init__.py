"""The error of the tool itself on a user's own pair, see `prove`."""
