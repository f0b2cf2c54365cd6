"""Importers: mechanisms from URDF, MJCF and SDF files; one neutral tree, its dynamics, and the scenes made of it."""
