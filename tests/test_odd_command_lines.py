"""Wrong command lines, and odd ones as people type them: refused in one sentence, exit code 2, nothing is written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from test_command_lines import CRANE, WRONG, run

pytestmark = pytest.mark.usefixtures("empty_folder")

FILES = {
    "bad.csv": "time,a,b\n0,1,2\n",
    "one.csv": "time,x,y,z\n0,5,0,-5\n",
    "way.csv": "time,x,y,z\n0,5,0,-5\n20,-2,2,-2\n",
    "still.csv": "time,x,y,z\n" + "".join(f"{t},5.1,0.3,-5\n" for t in range(30)),
    "unknown.toml": "nothing = 3\n",
    "neg.toml": "load_mass = -3\n",
    "afile": "hello",
    "broken.py": "1/0\n",
}

TABLE = """
crane-fmu feedforward {CRANE} --duration 0 -> the duration of a path must be a positive time, not 0.0 s
crane-fmu feedforward {CRANE} --duration 1e12 -> the duration of 1e+12 s is longer than the limit of 1e+09 s
crane-fmu feedforward {CRANE} --duration 1e-12 -> the rope goes slack: g + z'' is
crane-fmu feedforward --from inf 0 -5 --to 5 0 -5 --duration 20 -> start point 0, component 0 is inf, not a finite
crane-fmu feedforward --from 5 0 -5 --from 4 0 -5 --to 3 0 -5 --duration 20 --step 0.3 -> the step of 0.3 s does not
crane-fmu feedforward {CRANE} --duration 20 --rtol 0 -> tolerances must be finite and not negative, one of them
crane-fmu feedforward {CRANE} --duration 20 --rtol 1e-3 --output-step 0.7 -> the step of 0.7 s does not divide the
crane-fmu feedforward {CRANE} --duration 20 --profile three-phase --ramp 0 -> the ramp of a three-phase profile must
crane-fmu feedforward --columns , -> --columns: there is no ''; there are M_b, F, M_w, phi, s, l
crane-fmu feedforward --plot .png -> cannot draw .png: the name must end in .png, .svg, .pdf
crane-fmu feedforward --reference . -> . cannot be read: Is a directory
crane-fmu feedforward --reference bad.csv -> bad.csv, line 1: the header time,x,y,z, optionally followed
crane-fmu feedforward --reference way.csv --tolerance 0 -> way.csv, line 3: the file ends after 2 rows of data, but
crane-fmu feedforward --waypoints one.csv -> one.csv, line 2: the file ends after 1 rows of data, but such
crane-fmu feedforward --waypoints way.csv --tolerance 1mm -> --tolerance belongs to --reference: it bounds the
crane-fmu feedforward --limits unknown.toml -> rotary crane, points reports nothing called nothing that
crane-fmu feedforward --limit F= -> --limit F= is no NAME=NUMBER or NAME=LOW..HIGH: write it as in
crane-fmu feedforward --limit F=60.. -> rotary_crane: at t = 0 s F goes beyond its lower limit of 60
crane-fmu feedforward --limit F=0 -> the limit of F is '0': one number is the largest magnitude
crane-fmu feedforward --limit F=inf -> the limit of F is given as 'inf', which is no number with a
crane-fmu feedforward --limit s.rate.rate=1 -> rotary crane, points reports nothing called s.rate.rate that
crane-fmu feedforward -ox/y.csv -> cannot write x/y.csv: there is no folder x; make it first
servocore feedforward '' -> no scene is called ''; there are rotary_crane
servocore feedforward rotary_crane: -> rotary_crane:: there is no module rotary_crane
servocore feedforward os:getcwd -> os:getcwd returns str, not a Scene
servocore feedforward os:nothing -> os:nothing: the module os has no function 'nothing'
servocore feedforward a..b:scene -> a..b:scene: there is no module a..b
servocore feedforward broken:scene -> broken:scene: the module cannot be imported
servocore feedforward cars --from 0 --to 1 0 --duration 2 -> --to 1 0: it needs 1 number, y: write it as --to Y
servocore feedforward cars --from 0 --to 1 --duration 2 --limit u=0..0 -> the limit of u must run from a lower to an
servocore feedforward overhead_crane --from 0,-4 --to 5,4 --duration 6 -> at t = 3 s the load is not below the
servocore analyse -> see servocore analyse --help
servocore scenes cars -> see servocore scenes --help
crane-fmu plan {CRANE} -> rotary_crane has no limits: without any there is no fastest
crane-fmu plan {CRANE} --limit F=60 --robust load_mass=1.1..0.9 -> write it as in --robust load_mass=0.9..1.1
crane-fmu plan {CRANE} --limit F=60 --robust load_mass=-1..1 -> parameter load_mass = -100 kg is outside its range
crane-fmu plan {CRANE} --limit F=60 --robust nothing=0.9..1.1 -> rotary_crane has no parameter nothing
crane-fmu plan {CRANE} --limit F=60 --robust load_mass=0.9..1.1 --robust load_mass=0.8..1.2 -> --robust gives
crane-fmu plan {CRANE} --limit F=60 --free --keep-out 'sphere 1 2' -> --keep-out 'sphere 1 2' is neither 'sphere'
crane-fmu plan {CRANE} --limit F=60 --free --keep-out 'sphere 1 2 3 -4' -> the radius of a sphere must be positive
crane-fmu plan {CRANE} --limit F=60 --free --keep-out 'sphere 1 2 -3 1' --clearance-of hook -> 'hook' is no part that
crane-fmu plan {CRANE} --via 1 2 -3 --limit F=60 --free -> a plan with a free path runs from one point to another
crane-fmu plan --from 5 0 -5 --to 5 0 -5 --limit F=60 -> waypoints 0 and 1 coincide: the path does not move there
crane-fmu plan --reference still.csv --limit F=60 -> the path stays where it is: there is nothing to be passed
crane-fmu plan {CRANE} --limit F=60 --write-path x.csv -o x.csv -> --write-path and --output both name x.csv
crane-fmu plan {CRANE} --reference way.csv --limit F=60 -> a path is given either by --reference or by --from, not by
crane-fmu view --step 1e-9 -> a step of 1e-09 s makes more than 1e+07 rows: take a larger
crane-fmu build --targets linux64 -> FMI 2 has no platform 'linux64'; there are x86_64-linux
crane-fmu build --targets none -> have host among its platforms
crane-fmu build --parameters neg.toml -> neg.toml: parameter load_mass = -3 kg is outside its range
crane-fmu ssp -o afile/deep -> is a file, not a folder; name another place
crane-fmu ssp --native=yes -> see crane-fmu ssp --help
crane-fmu drive . -> cannot read . as an FMU: Error reading file
crane-fmu drive afile -> cannot read afile as an FMU: File is not a zip file
crane-fmu drive afile --map =x -> write it as in --map F=trolley.force
crane-fmu drive afile --map G=x -> there is no signal 'G' to map
crane-fmu drive afile --map none.toml -> none.toml cannot be read: No such file or directory
crane-fmu drive afile --set a= -> write it as in --set start.swing=0.1
crane-fmu drive afile {CRANE} --duration 20 -o afile -> cannot write afile: it is read as well
crane-fmu build --page x.md -o x -> --page writes no FMU: not with --output or --targets
crane-fmu Feedforward -> did you mean feedforward
crane-fmu --versions -> see crane-fmu --help
servocore sensitivities cars --wrt none -> cars has no parameter none
servocore sensitivities cars --from 0 --to 1 -> a straight line also needs --duration
servocore sensitivities cars --output x.svg --plot x.svg -> --output and --plot both name x.svg
servocore sweep cars -o s --vary load=1..2:0 -> --vary: the range of load needs a count of at least 1: write it as in
servocore sweep cars -o s --vary load=1..inf:3 -> --vary: the range 1..inf of load is not finite, or does not run
servocore sweep cars -o s --vary duration=1..2:3 --seed 4 -> --seed belongs to --sample
servocore sweep cars -o s --vary duration=1..2:3 --scheduler nowhere -> no Dask scheduler answers at nowhere: missing
servocore sweep cars -o s --vary duration=1..2:100000000000 -> more than 1e+07 values or instants fill the memory
servocore effects overhead_crane --bandwidth 0 -> the bandwidth of position loops must be positive and finite, not 0
servocore effects overhead_crane --parameters unknown.toml -> unknown.toml: no parameter is called 'nothing'; there
servocore export cars -o x -> cannot write x: the name of an FMU ends with .fmu, or tools
servocore export cars -o x.fmu --plant --cross-check -> --cross-check is for inverse models: not with --plant
servocore export cars -o x.fmu --trajectory --wasm x.wasm -> --wasm is for inverse models: not with --trajectory
servocore export cars --fmi 3 -> --fmi belongs to an FMU: name it with -o FILE.fmu
servocore export cars --cross-check -> --cross-check belongs to an FMU: name it with -o FILE.fmu
servocore excite cars --estimate mass_1 --limit u=9 --uncertainty 20 -> must be a share, 1 at most, not 20: 0.2 is 20%
servocore export cars --wasm x.js -> cannot write x.js: the name of a WebAssembly module ends with
servocore export cars -o x.fmu --c x.fmu -> --c and --output both name x.fmu
servocore cache clear now -> see servocore cache --help
servocore cache clean -> servocore: there is no action 'clean'; there are clear: write it as in clear
servocore --verbose -> see servocore --help
servocore sweep cars -o s --vary duration=1..2 --sample 100000000000 -> more than 1e+07 values or instants fill the
servocore sweep cars -o s --vary duration=1..2:3 --instants 1000000000 -> more than 1e+07 values or instants fill the
crane-fmu drive afile --set a=nan -> write it as in --set start.swing=0.1
servocore export cars --limit u=3 -> see servocore export --help
crane-fmu feedforward --from 1e308 0 -5 --to -1e308 1 -5 --duration 20 -> at t = 0 s
crane-fmu feedforward --rtol 1e-3 --output-step 1e-9 -> makes more than 1e+07 rows: take a larger
crane-fmu feedforward -o {NULL} -> is no ordinary file
crane-fmu feedforward -o o.csv --limit F=17 -> rotary_crane: at t = 5.51236 s F goes beyond its lower limit of -17 N; it
crane-fmu feedforward --limit M_w=..-98 -> goes beyond its upper limit of -98 N.m; it reaches -97.3419 N.m
crane-fmu feedforward --limit 'swing = 1 deg' -> goes beyond its upper limit of 1 deg; it reaches 1.00332 deg
crane-fmu feedforward --limit M_w=50 -> no duration helps
crane-fmu plan {CRANE} --limit F=60 --free -> needs a limit of every input; M_b has none
crane-fmu plan {CRANE} {ALL} --free --keep-out 'sphere 3 0 0 1' --clearance-of 'load, bridge' -> of load, bridge is 1 m
servocore plan overhead_crane --from 0 -4 --to 5 -4 --limit M_w=50 -> keeps the limit of M_w: even at rest at (0, -4)
servocore plan overhead_crane --from 0 -4 --to 5 -4 --limit F=1e-9 -> keeps them in no 1e+06 s are not planned
servocore plan overhead_crane --from 0 -4 --to 5 -4 --limit F=200 --robust load_mass=90..110 -> has to hold 1, its own
servocore effects cars -> cars declares no effects
servocore plan elastic_bar --from 0 --to 1 --limit u=20 --write-path x.csv -> of a path, but the inputs of elastic_bar
servocore plan boom_crane {BOOM} -> height zero, nor a bridge: plan with --clearance-of load
servocore plan boom_crane {BOOM} --clearance-of load -> at rest at (5, 0, 1) a point of load is 0.5 m inside
"""
"""Command lines, what the refusal says behind an arrow, and in braces what `WORDS` has."""

WAY = "--from 5 0 1 --to 4 3 1 --free --keep-out 'sphere 5 0 1 0.5'"
WORDS = {
    "CRANE": CRANE,
    "NULL": os.devnull,
    "ALL": "--limit M_b=1000 --limit F=60 --limit M_w=-108..-88",
    "BOOM": f"{WAY} --limit M_s=3000 --limit M_l=-2e4..2e4 --limit M_w=-150..-50",
}

ODD = [tuple(row.format(**WORDS).split(" -> ")) for row in TABLE.strip().splitlines()]


@pytest.mark.parametrize(("line", "said"), [*WRONG, *ODD], ids=[line for line, _ in (*WRONG, *ODD)])
def test_a_wrong_command_line_is_refused_with_the_right_form(line: str, said: str) -> None:
    for name, text in FILES.items():
        Path(name).write_bytes(text.encode("latin-1"))
    command_line, result = run(line)
    command_line.assert_refused(result, said)
    left = {each.name for each in Path().iterdir()} - {"__pycache__"}
    assert left == set(FILES)
    assert all(Path(name).read_bytes() == text.encode("latin-1") for name, text in FILES.items())


def test_every_line_is_in_one_of_the_tables_once() -> None:
    lines = [line for line, _ in (*ODD, *WRONG)]
    assert len({*lines}) == len(lines)
