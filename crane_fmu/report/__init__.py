"""The report of the demo: results as figures, tables and text on one page."""
