"""What damages a file: each mutator is a function of a random generator and the content.

A mutator returns the damaged content and a few words that say what it did. It draws from its generator alone,
so the same seed gives the same mutant on every machine.
"""
