"""The command line: one file per command; large libraries are imported only when a command runs."""
