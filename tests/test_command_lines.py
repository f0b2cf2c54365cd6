"""All options of all commands in one table, and wrong command lines, which `test_odd_command_lines` types."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click
import pytest
from click.testing import CliRunner
from command_lines import PROGRAMS, CommandLine

from crane_fmu.cli.commands import CRANE as FIXED
from servocore.cli.command import Command
from servocore.cli.console import ON_THE_COMMAND_LINE
from servocore.cli.kinds import Kind

pytestmark = pytest.mark.usefixtures("empty_folder")

ROOT = Path(__file__).resolve().parents[1]

ALONG = {"feedforward", "plan", "sensitivities", "sweep", "effects", "drives", "view", "export", "ssp"}
SUBJECT = ALONG | {"analyse", "import"}
IDENTIFYING = {"identify", "excite"}
BOUNDED = {"feedforward", "plan", "sweep", "view"}
FMUS = {"crane-fmu build", "crane-fmu ssp", "crane-fmu drive"}
BOUND = {"crane-fmu feedforward", "crane-fmu plan", "crane-fmu view"}
DRIVEN = {"crane-fmu ssp", "crane-fmu drive"}


def of_servocore(names: set[str]) -> set[str]:
    return {f"servocore {name}" for name in names}


def of_both(names: set[str]) -> set[str]:
    """Commands of servocore, and those of crane-fmu that are the same."""
    return of_servocore(names) | {name for name in BOUND if name.split()[1] in names}


class Option(NamedTuple):
    """Where an option is known, a right value, and what it then is."""

    commands: set[str]
    right: str
    value: object = ...


LINES = of_both(ALONG - {"plan"}) | DRIVEN
OPTIONS = {
    "--parameters": Option(of_both(SUBJECT) | of_servocore(IDENTIFYING) | FMUS, "crane.toml", Path("crane.toml")),
    "--drives": Option(of_both(SUBJECT) | of_servocore(IDENTIFYING) | FMUS, "drives.toml", Path("drives.toml")),
    "--model": Option(of_both(SUBJECT - {"effects"}), "points", "points"),
    "--servo-output": Option(of_servocore(SUBJECT | IDENTIFYING), "tool0", ("tool0",)),
    "--elastic": Option(of_servocore(SUBJECT | IDENTIFYING), "elbow=1e4", ({"elbow": 1e4},)),
    "--motor-inertia": Option(of_servocore(SUBJECT | IDENTIFYING), "0.3", 0.3),
    "--import": Option(of_servocore(SUBJECT | IDENTIFYING), "arm.toml", Path("arm.toml")),
    "--reference": Option(of_both(ALONG) | DRIVEN, "path.csv", Path("path.csv")),
    "--tolerance": Option(of_both(ALONG) | DRIVEN, "1mm", "1mm"),
    "--waypoints": Option(of_both(ALONG) | DRIVEN, "way.csv", Path("way.csv")),
    "--from": Option(of_both(ALONG) | DRIVEN, "5 0 -5", (5.0, 0.0, -5.0)),
    "--to": Option(of_both(ALONG) | DRIVEN, "5,0,-5", (5.0, 0.0, -5.0)),
    "--via": Option(of_both({"plan"}), "1 -2e-1 -.5", ((1.0, -0.2, -0.5),)),
    "--duration": Option(LINES | {"servocore excite"}, "20s", 20.0),
    "--profile": Option(LINES, "degree-9"),
    "--ramp": Option(LINES, "500ms", 0.5),
    "--limit": Option(of_both(BOUNDED) | {"servocore excite", "crane-fmu drive"}, "swing=5deg", ({"swing": "5deg"},)),
    "--limits": Option(of_both(BOUNDED) | {"servocore excite", "crane-fmu drive"}, "limits.toml", Path("limits.toml")),
    "--step": Option(
        of_both({"feedforward", "plan", "sensitivities", "drives", "view"}) | {"crane-fmu drive"}, "0.1", 0.1
    ),
    "--formulation": Option(of_both({"feedforward"}), "Projected"),
    "--method": Option(of_both({"feedforward"}), "backwardeuler"),
    "--rtol": Option(of_both({"feedforward"}), "1e-3", 1e-3),
    "--atol": Option(of_both({"feedforward"}), "1e-3", 1e-3),
    "--output-step": Option(of_both({"feedforward"}), "0.1", 0.1),
    "--columns": Option(of_both({"feedforward", "plan"}), "F,swing", "F,swing"),
    "--plot": Option(of_both({"feedforward", "plan", "sensitivities"}), "p.png", Path("p.png")),
    "--verbose": Option(of_both({"feedforward"}), "", True),
    "--output": Option(
        of_both({"feedforward", "plan", "sensitivities", "sweep", "view", "export", "ssp"})
        | of_servocore(IDENTIFYING) | FMUS | {"crane-fmu demo"},
        "result", Path("result"),
    ),
    "--robust": Option(of_both({"plan"}), "load_mass=0.9..1.1", ({"load_mass": (0.9, 1.1)},)),
    "--free": Option(of_both({"plan"}), "", True),
    "--keep-out": Option(of_both({"plan"}), "'sphere 1 2 -3 1'", ("sphere 1 2 -3 1",)),
    "--clearance-of": Option(of_both({"plan"}), "load,rope", "load,rope"),
    "--write-path": Option(of_both({"plan"}), "way.csv", Path("way.csv")),
    "--wrt": Option(of_servocore({"sensitivities"}), "load_mass", ("load_mass",)),
    "--vary": Option(of_servocore({"sweep"}), "load_mass=50..150:3", ({"load_mass": (50.0, 150.0, 3)},)),
    "--sample": Option(of_servocore({"sweep"}), "9", 9),
    "--seed": Option(of_servocore({"sweep", "excite"}), "0", 0),
    "--instants": Option(of_servocore({"sweep"}), "11", 11),
    "--inputs": Option(of_servocore({"sweep"}), "", True),
    "--scheduler": Option(of_servocore({"sweep"}), "tcp://here:1", "tcp://here:1"),
    "--resume": Option(of_servocore({"sweep"}), "", True),
    "--parquet": Option(of_servocore({"sweep"}), "", True),
    "--deviation": Option(of_servocore({"effects"}), "5mm", "5mm"),
    "--bandwidth": Option(of_servocore({"effects", "identify"}), "3", 3.0),
    "--open-loop": Option(of_servocore({"effects"}), "", True),
    "--simulate": Option(of_servocore({"effects"}), "", True),
    "--markdown": Option(of_servocore({"effects"}), "e.md", Path("e.md")),
    "--estimate": Option(of_servocore(IDENTIFYING), "load_mass", "load_mass"),
    "--effects": Option(of_servocore(IDENTIFYING), "friction", "friction"),
    "--uncertainty": Option(of_servocore(IDENTIFYING), "20%", "20%"),
    "--job": Option(of_servocore({"identify"}), "job.csv", (Path("job.csv"),)),
    "--page": Option(of_servocore({"identify"}) | {"crane-fmu build"}, "page.html", Path("page.html")),
    "--fmi": Option(of_servocore({"export", "ssp"}), "2", 2),
    "--no-stdio": Option(of_servocore({"export", "ssp"}), "", True),
    "--max-internal-steps": Option(of_servocore({"export", "ssp"}), "50", 50),
    "--targets": Option(
        {"servocore export", "servocore ssp", "crane-fmu build", "crane-fmu ssp"}, "host", "host"),
    "--cross-check": Option(of_servocore({"export"}), "", True),
    "--c": Option(of_servocore({"export"}), "source", Path("source")),
    "--about": Option(of_servocore({"export", "ssp"}), "vendor.toml", Path("vendor.toml")),
    "--wasm": Option(of_servocore({"export"}), "crane.wasm", Path("crane.wasm")),
    "--plant": Option(of_servocore({"export"}), "", True),
    "--trajectory": Option(of_servocore({"export"}), "", True),
    "--native": Option({"crane-fmu ssp"}, "", True),
    "--no-certify": Option(
        of_both({"feedforward", "plan"}) | {"servocore export", "servocore ssp", "crane-fmu ssp", "crane-fmu demo"},
        "", True,
    ),
    "--fmu": Option({"crane-fmu build"}, "CranePlant"),
    "--map": Option({"crane-fmu drive"}, "F=trolley.force", ({"F": "trolley.force"},)),
    "--set": Option({"crane-fmu drive"}, "start.position[1]=5.1", ({"start.position[1]": 5.1},)),
}  # fmt: skip


def commands() -> Iterator[tuple[str, Command]]:
    for program, line in PROGRAMS.items():
        for name, command in line.app.commands.items():
            assert isinstance(command, Command)
            yield f"{program} {name}", command


COMMANDS = dict(commands())


def argument_of(command: Command) -> list[str]:
    """Return what a command must be given without a flag."""
    kinds = [each for each in command.params if isinstance(each, click.Argument) and each.required]
    return ["rotary_crane" if each.name == "scene" else "plant.fmu" for each in kinds]


def run(line: str) -> tuple[CommandLine, Any]:
    program, *words = shlex.split(line)
    return PROGRAMS[program], PROGRAMS[program](*words)


def test_the_table_names_all_options_of_all_commands() -> None:
    found = {
        (name, max(each.opts, key=len))
        for name, command in COMMANDS.items()
        for each in command.params
        if isinstance(each, click.Option)
    }
    assert found == {(name, option) for option, row in OPTIONS.items() for name in row.commands}


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_means_the_same_in_every_command(option: str) -> None:
    row = OPTIONS[option]
    declared = set()
    for name in row.commands:
        command = COMMANDS[name]
        (param,) = [each for each in command.params if option in each.opts]
        words = [*argument_of(command), option, *shlex.split(row.right)]
        if name == "servocore sweep" and option != "--output":
            words += ["--output", "study"]
        value = command.make_context(name, words).params[str(param.name)]
        assert row.value is ... or value == row.value
        kind = None if option == "--output" else type(param.type)  # of a file, or a folder
        declared.add((str(param.name), kind, tuple(sorted(param.opts)), param.multiple))
    assert len(declared) == 1


def test_commands_of_the_crane_are_those_of_servocore_with_the_scene_fixed() -> None:
    for name in BOUND:
        crane, general = COMMANDS[name], COMMANDS[f"servocore {name.split()[1]}"]
        assert crane.function is general.function
        assert [each.opts for each in crane.params] == [each.opts for each in general.params if each.name not in FIXED]


@pytest.mark.parametrize("name", ["crane-fmu feedforward", "crane-fmu plan"])
def test_their_tables_are_the_same(name: str) -> None:
    command = name.split()[1]
    more = "--duration 20" if command == "feedforward" else "--limit F=60 --limit M_b=1000"
    line = f"--from 5 0 -5 --to -2 2 -2 {more}"
    (_, crane), (_, general) = run(f"{name} {line}"), run(f"servocore {command} rotary_crane {line}")
    assert crane.stdout == general.stdout
    assert crane.stdout.startswith("time,M_b,F,M_w,phi,s,l,x,y,z,tension")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_value_that_is_missing_or_empty_is_refused_with_an_example(name: str) -> None:
    command = COMMANDS[name]
    program, word = name.split()
    line = PROGRAMS[program]
    for param in command.params:
        if isinstance(param, click.Option) and isinstance(param.type, Kind):
            option = max(param.opts, key=len)
            right = f": write it as in {option} {param.type.example}"
            for behind in ([], ["--help"], [option], [""]):
                result = line(word, *argument_of(command), *param.opts[:1], *behind)
                line.assert_refused(result, right if behind == [""] else f"{option} needs a value{right}")
    assert list(Path().iterdir()) == []


FF, CRANE = "crane-fmu feedforward", "--from 5 0 -5 --to -2 2 -2"
WRONG = [
    # times
    *[(f"{command} {option} {value}", f"write it as in {option} {'0.1' if 'step' in option else '20'}")
      for command, option in (
          (FF, "--duration"), (FF, "--step"), (FF, "--ramp"), (FF, "--output-step"),
          ("crane-fmu drive p.fmu", "--step"), ("servocore sweep cars -o s", "--duration"))
      for value in ("long", "nan", "inf", "5m", "5kg")],
    *[(f"{FF} {option} {value}", f"must be a positive time, not {value} s: write it as in {option} 0.1")
      for option in ("--step", "--output-step") for value in ("0", "-1")],
    (f"{FF} --step 1e-9", "a step of 1e-09 s makes more than 1e+07 rows: take a larger step"),
    (f"{FF} --step 0.3", "does not divide the duration of 20 s; the nearest that do are"),
    # numbers
    *[(f"{FF} {option} {value}", f"write it as in {option} 1e-3")
      for option in ("--rtol", "--atol") for value in ("small", "nan", "1mm", "1,5")],
    *[(f"servocore sweep cars -o s {option} {value}", f"write it as in {option}")
      for option in ("--sample", "--instants") for value in ("0", "-1", "many", "1.5", "1e3")],
    *[(f"servocore sweep cars -o s --seed {value}", "write it as in --seed 1") for value in ("-1", "x", "0.5")],
    *[(f"servocore effects cars --bandwidth {value}", "write it as in --bandwidth 1e-3") for value in ("fast", "3rad")],
    # points
    *[(f"{FF} --from {value} --to 5 0 -5 --duration 20", "it needs 3 numbers, x, y, z: write it as --from X Y Z")
      for value in ("5", "5 0", "5,0", "5 0 -5 1", "5,0,-5,1", "5;0;-5;3")],
    *[(f"crane-fmu {command} --from 5 0 -5 --to 5 0 {more}", "write it as --to X Y Z")
      for command, more in (("feedforward", "--duration 9"), ("plan", "--limit F=60"), ("view", "--duration 9"),
                            ("ssp", "--duration 9"), ("drive p.fmu", "--duration 9"))],
    *[(f"servocore {command} overhead_crane --from 0 --to 5 -4 --duration 9 {more}", "write it as --from X Z")
      for command, more in (("feedforward", ""), ("view", ""), ("effects", ""), ("sensitivities", ""),
                            ("sweep", "--vary load_mass=50..60:2 -o s"), ("export", "--trajectory -o t.fmu"))],
    (f"crane-fmu plan {CRANE} --via 1 2 --limit F=60", "--via 1 2: it needs 3 numbers, x, y, z: write it as --via X"),
    *[(f"{FF} --from {value} --to 5 0 -5 --duration 20", "--from 5 0 -5")
      for value in ("a", "a,b,c", ",,", "(5,0,-5)", "5m")],
    (f"{FF} {CRANE} --duration 20 7", "got unexpected extra argument"),
    # half a line, two paths, what belongs to something else
    (f"{FF} --from 5 0 -5", "a straight line also needs --to and --duration"),
    (f"{FF} --to 5 0 -5 --duration 5", "a straight line also needs --from"),
    (f"{FF} --profile degree9", "a straight line also needs --from and --to and --duration"),
    (f"crane-fmu plan {CRANE[:13]} --limit F=60", "no path is given: use --from and --to, --reference, or --waypoints"),
    *[(f"crane-fmu {command} --reference a.csv {other}", "a path is given either by --reference or by")
      for command in ("feedforward", "view", "ssp", "drive p.fmu")
      for other in ("--waypoints b.csv", "--from 5 0 -5", "--duration 3", "--profile degree9")],
    *[(f"crane-fmu {command} --tolerance 1mm {CRANE} {more}", "--tolerance belongs to --reference")
      for command, more in (("feedforward", "--duration 20"), ("plan", "--limit F=60"), ("view", "--duration 20"),
                            ("ssp", "--duration 20"))],
    ("servocore effects rotary_crane --tolerance 5mm", "the allowed tracking error is --deviation, as in"),
    (f"{FF} {CRANE} --duration 20 --ramp 3", "--ramp belongs to --profile three-phase"),
    (f"{FF} {CRANE} --duration 20 --profile three-phase --ramp 11", "at least 22.0 s, but its duration is 20.0 s"),
    (f"{FF} --output-step 0.1", "--output-step belongs to --rtol or --atol"),
    (f"{FF} --step 0.1 --rtol 1e-3", "either by --step or by --rtol and --atol, not by both"),
    (f"crane-fmu plan {CRANE} --keep-out 'sphere 1 2 -3 1' --limit F=60", "--keep-out belongs to --free"),
    (f"crane-fmu plan {CRANE} --free --clearance-of load --limit F=60", "--clearance-of belongs to --keep-out"),
    ("servocore export cars --plant --trajectory -o x.fmu", "export one at a time"),
    ("servocore export cars --from 0 --to 1 --duration 2 -o x.fmu", "--from belongs to --trajectory"),
    ("servocore export cars", "name the file to write with -o FILE.fmu"),
    ("servocore export cars --c d --targets host", "name it with -o FILE.fmu"),
    ("servocore effects cars --open-loop --bandwidth 3", "--open-loop excludes --bandwidth: there are no position"),
    # tolerances and deviations
    *[(f"{FF} --reference path.csv --tolerance {value}", "write it as in --tolerance 1mm")
      for value in ("1kg", "wide", "inf", "1deg")],
    *[(f"servocore effects overhead_crane --deviation {value}", "write it as in --deviation 5mm")
      for value in ("5", "5kg", "far", "5deg")],
    # names
    (f"{FF} --profile degree8", "there is no profile 'degree8'; there are degree9, degree13, three-phase"),
    (f"{FF} --formulation index9", "there is no formulation 'index9'; there are reduced, projected, original"),
    (f"{FF} --method euler", "there is no method 'euler'; there are backward-euler"),
    (f"{FF} --model large", "it has points, generalized, bodies"),
    ("servocore feedforward train", "no scene is called train; there are rotary_crane"),
    (f"{FF} --columns F,sway", "--columns: there is no 'sway'; there are M_b, F, M_w"),
    (f"{FF} --columns F,F", "--columns names F twice: write it once, as in --columns"),
    ("servocore export cars -o x.fmu --fmi 1", "there are 2 and 3"),
    ("servocore export cars -o x.fmu --fmi two", "--fmi two is no version of FMI: write it as in --fmi 3"),
    ("servocore export cars -o x.fmu --targets amiga", "no platform 'amiga'"),
    ("servocore cache empty", "there is no action 'empty'; there are clear: write it as in clear"),
    # ranges
    (f"{FF} --limit F", "--limit F is no NAME=NUMBER or NAME=LOW..HIGH: write it as in --limit F=60"),
    (f"{FF} --limit M_w=-104:-92", "a range is written M_w=-104..-92"),
    (f"{FF} --limit F=60 --limit F=61", "--limit gives F twice"),
    (f"{FF} --limit swing=5", "write '5 deg'"),
    (f"{FF} --limit thrust=5", "reports nothing called thrust that could have a limit; there are"),
    (f"crane-fmu plan {CRANE} --limit F=60 --robust load_mass=0.9:1.1", "NAME=LOW..HIGH: write it as in --robust load"),
    *[(f"servocore sweep rotary_crane -o s --vary {value}", "NAME=LOW..HIGH:COUNT: write it as in --vary load")
      for value in ("load_mass", "load_mass=50:150:100", "load_mass=a..150:3")],
    ("servocore sweep rotary_crane -o s --vary load_mass=50..150", "is written load_mass=LOW..HIGH:COUNT"),
    ("servocore sweep rotary_crane -o s --vary load_mass=50..150:3 --sample 5", "with --sample load_mass=LOW..HIGH"),
    ("servocore sweep rotary_crane -o s", "nothing varies: use --vary NAME=LOW..HIGH:COUNT"),
    # files
    (f"{FF} --plot p.gif", "cannot draw p.gif: the name must end in .png, .svg, .pdf"),
    (f"{FF} -o -", "cannot write -: name a file"),
    (f"{FF} -o p.png --plot p.png", "both name p.png"),
    (f"{FF} --reference a.csv -o a.csv", "it is read as well"),
    (f"{FF} --reference none.csv", "none.csv cannot be read"),
    (f"{FF} --parameters none.toml", "none.toml cannot be read"),
    ("servocore view cars -o cars.pdf", "the name of a page ends with .html"),
    ("crane-fmu drive none.fmu", "cannot read none.fmu"),
    ("crane-fmu drive p.fmu --map F", "--map F is no OURS=THEIRS, nor a file that ends in .toml: write it as in"),
    ("crane-fmu drive p.fmu --set a", "--set a is no NAME=NUMBER: write it as in --set start.swing=0.1"),
    # words that there are not, and those that there were
    (f"{FF} --spep 3", "did you mean --step; see crane-fmu feedforward --help"),
    (f"crane-fmu plan {CRANE} --by 1 2 -3 --limit F=60", "--by is --via since version 0.3"),
    (f"crane-fmu plan {CRANE} --limit F=60 --path way.csv", "--path is --write-path since version 0.3"),
    (f"servocore plan overhead_crane {CRANE} --limit F=60 --parts load", "--parts is --clearance-of since version 0.3"),
    (f"{FF} --verbose=1", "option '--verbose' does not take a value; see crane-fmu feedforward --help"),
    (f"{FF} more", "got unexpected extra argument (more); see crane-fmu feedforward --help"),
    ("servocore sweep cars --vary duration=5..9:3", "see servocore sweep --help"),
    ("servocore solve", "no such command 'solve'; see servocore --help"),
    ("crane-fmu", "see crane-fmu --help"),
    ("servocore levels cars", "levels is a benchmark: python -m benchmarks.levels SCENE"),
    ("servocore -v", "the version is printed by --version or -V"),
]  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_a_help_shows_options_and_no_inner_words(name: str) -> None:
    program, word = name.split()
    text = PROGRAMS[program](word, "--help").stdout
    for each in COMMANDS[name].params:
        assert all(option in text for option in each.opts if option.startswith("-"))
    assert not re.search(r"\[default|<bool>|<str>|\bPython: |\[/?cyan\]", text)
    for example in COMMANDS[name].examples:
        whole = re.sub(r" \\\n +", " ", text)
        assert f"{name} {example}".rstrip() in whole


def test_what_is_advised_in_python_is_said_somewhere_in_the_library() -> None:
    sources = [
        file.read_text(encoding="utf-8") for file in (ROOT / "servocore").rglob("*.py") if "cli" not in file.parts
    ]
    whole = re.sub(r'"\s*\n\s*f?"', "", "\n".join(sources))
    assert [each for each in ON_THE_COMMAND_LINE if not re.search(each, whole)] == []


@pytest.mark.parametrize("width", [60, 80, 100])
@pytest.mark.parametrize("name", [*PROGRAMS, *COMMANDS])
def test_a_help_is_as_wide_as_the_terminal_and_breaks_no_word(name: str, width: int) -> None:
    program, *words = name.split()
    text = CliRunner().invoke(PROGRAMS[program].app, [*words, "--help"], prog_name=program, terminal_width=width).stdout
    assert [line for line in text.splitlines() if len(line) > width or re.search(r"\w-$", line)] == []
