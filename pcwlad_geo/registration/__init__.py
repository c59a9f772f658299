"""The registration of a pair up to its result: initial alignment, plan, matching, verdict and fit."""
