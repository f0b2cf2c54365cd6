"""Reference paths gamma(t): values that answer with exact derivatives at any times."""
