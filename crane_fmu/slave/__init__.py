"""What travels into the FMUs: slaves, and what they compute, on NumPy, CasADi and PythonFMU only."""
