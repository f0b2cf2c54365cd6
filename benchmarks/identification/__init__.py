"""Identification of random cranes from synthetic logs, beside other methods; `make identification` writes the page."""
