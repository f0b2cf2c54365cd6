"""Reference paths gamma(t): immutable, with exact derivatives of the orders they promise."""
