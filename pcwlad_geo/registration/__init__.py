"""The job, up to its result: pre-align, plan tiles, match, merge, fit, judge."""
