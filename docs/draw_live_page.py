"""Draw docs/pictures/live_page.png: the live page of the rotary crane in a browser."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import servocore as sc

TARGET = Path(__file__).parent / "pictures" / "live_page.png"


def main() -> None:
    """Write the page with less time than the limits allow, and let Chromium draw it while the crane moves."""
    browser = shutil.which("chromium")
    if browser is None:
        sys.exit("chromium is missing: the picture of the live page stays as it is")
    scene = sc.scenes.rotary_crane().with_limits(M_b=150, F=22, M_w=120)
    path = scene.reference
    start, end = path.jet([path.start_time, path.end_time], 0)[:, 0]
    faster = scene.with_reference(sc.rest_to_rest(start, end, 19.0))
    with tempfile.TemporaryDirectory() as folder:
        page = sc.view(sc.solve(faster, step=0.095, checks=False), Path(folder) / "crane.html")
        look = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1280,1000"]
        shot = f"--screenshot={TARGET}"
        command = [browser, *look, f"--user-data-dir={folder}/profile", shot, f"{page.as_uri()}#t=8"]
        subprocess.run(command, check=True, capture_output=True, timeout=120)


if __name__ == "__main__":
    main()
