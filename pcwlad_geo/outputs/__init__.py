"""The output files of a job: names, writers, and a folder that is written completely or not at all."""
