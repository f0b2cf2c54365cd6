"""Planning: the fastest law within limits."""
