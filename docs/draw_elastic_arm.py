"""Draw docs/pictures/elastic-arm.png: how far the tool of a UR5 with elastic joints strays under two feedforwards."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import servocore as sc

HERE = Path(__file__).parent
ARM = HERE.parent / "examples" / "ur5.urdf"
START = {"shoulder_lift_joint": -1.2, "elbow_joint": 1.4, "wrist_1_joint": -0.6, "wrist_2_joint": -1.2}
TOOL = ["tool0", "tool0.rx", "tool0.ry", "tool0.rz"]
WAY, DURATION = np.array([-0.15, 0.2, 0.1, 0.0, 0.3, 0.0]), 0.5
STIFFNESS, RIGID, MOTOR = 1e3, 1e8, 0.3  # N m/rad of the elastic joints, and so stiff that they are rigid; kg m2


def strays() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times (s) and, by the model of the feedforward, the distance of the tool from its path (mm)."""
    rigid, elastic = (
        sc.scenes.from_file(ARM, TOOL, posture=START, elastic={name: sc.Elastic(K, MOTOR) for name in joints()})
        for K in (RIGID, STIFFNESS)
    )
    home = np.array(rigid.model().home)
    path = sc.rest_to_rest(home.tolist(), (home + WAY).tolist(), DURATION)
    start = sc.solve(elastic.with_reference(path), step=DURATION / 200)
    at_rest = {name: float(start[name][0]) for name in elastic.model().coordinates.names}
    found = {}
    for name, scene in (("rigid joints", rigid), ("elastic joints", elastic)):
        inputs = sc.solve(scene.with_reference(path), step=DURATION / 200)
        run = sc.simulate(elastic.with_reference(path), inputs, start=at_rest)
        off = [run[f"tool0.{axis}"] - path.jet(run.t, 0)[:, 0, k] for k, axis in enumerate("xyz")]
        found[name] = 1e3 * np.linalg.norm(off, axis=0)
    return run.t, found


def joints() -> list[str]:
    """Return the names of the joints."""
    return [each.name for each in sc.scenes.from_file(ARM).model().outputs]


def main() -> None:
    """Write the picture and print the largest distances."""
    t, found = strays()
    figure, axes = plt.subplots(figsize=(7.0, 2.8), layout="constrained")
    for name, distance in found.items():
        axes.semilogy(t, np.maximum(distance, 1e-9), label=f"feedforward of {name}")
        print(f"{name}: {distance.max():.2g} mm")
    axes.set(xlabel="time (s)", ylabel="tool off its path (mm)")
    axes.legend()
    figure.savefig(HERE / "pictures" / "elastic-arm.png", dpi=120)


if __name__ == "__main__":
    main()
