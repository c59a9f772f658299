"""Plain twins of the compiled kernels: slow, short, and what these must equal."""
