"""Execution of the calls of a job: in this process, in own worker processes, or on a cluster."""
