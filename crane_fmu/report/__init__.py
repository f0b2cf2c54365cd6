"""Figures and the page that shows them: what was computed, as pictures, tables and text."""
