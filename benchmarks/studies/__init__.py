"""One study a module: a function that runs what it needs and yields tables."""
