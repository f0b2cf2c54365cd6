"""Any scene for any tool: its inverse model as native FMU (FMI 2 and 3) and as C source, without Python at run time."""
