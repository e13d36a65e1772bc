"""Self-contained HTML pages with tables: of one run, and of all runs of a root."""
