"""The FMUs there are and the choices they and the command line offer, by name: one table for all."""
