"""Self-contained HTML pages, with the tables they show: of one run, and of all runs of a root."""
