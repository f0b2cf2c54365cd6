"""Other solvers on the same problems: one file each, used as their documentation recommends."""
