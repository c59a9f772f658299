"""The report of a registration: statistics, figures, the page and report.json."""
