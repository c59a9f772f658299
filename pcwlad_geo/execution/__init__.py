"""Execution of the calls of a job: in threads of this process, in processes of its own, or on a cluster."""
