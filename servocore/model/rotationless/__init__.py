"""The rotationless formulation: parts, joints, assemblies; `servocore.rotationless` names what users need."""
