"""Robot files: dynamics, elastic joints, flatness, library scenes as files, changed and broken files, the command."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from command_lines import servocore
from outside.test_random_mechanisms import DIFFERENCE
from present import present
from robots import OWN, apart, apart_from_mujoco, apart_from_pinocchio, peer, simulated_stray, terms
from thinned import thinned

import servocore as sc
from servocore.importers.from_file import read_tree
from servocore.importers.mjcf import read_mjcf
from servocore.importers.xml_files import XmlFile

ARM, UR5 = OWN / "arm.urdf", OWN.parents[1] / "examples" / "ur5.urdf"
TURNS = {"turn": 0.3, "elbow": 0.4, "extend": 0.1}
WRENCH = [f"drone.{part}" for part in ("force_z", "torque_x", "torque_y", "torque_z")]
ALOFT: dict[str, Any] = {"outputs": ["load", "drone.rz"], "taut": ["rope"]}


@pytest.mark.parametrize("name", ["arm.urdf", "gantry.xml", "drone.xml", "fourbar.xml"])
def test_dynamics_are_those_of_pinocchio_or_mujoco(name: str) -> None:
    compared = apart_from_pinocchio if name.endswith("urdf") else apart_from_mujoco
    assert compared(OWN / name) < 1e-12


def test_both_readers_agree_on_a_urdf(tmp_path: Path) -> None:
    peer("mujoco")
    path = tmp_path / "arm.urdf"  # a mimic is a soft constraint for MuJoCo, which also drops massless links
    path.write_text(re.sub(r"<mimic[^>]*>", "", ARM.read_text()))
    one, other = (terms(tree) for tree in (read_tree(path), read_mjcf(XmlFile.read(path))))
    x, v = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 5))
    assert one[0].coordinates.names == other[0].coordinates.names
    pairs = zip(*(map(np.asarray, each[1](x, v)) for each in (one, other)), strict=True)
    assert apart(list(pairs)) < 1e-12


def test_the_default_path_takes_a_fifth_of_a_range_at_most_and_goes_back_from_its_end() -> None:
    """0.2 rad or 0.1 m where nothing limits the output."""
    for options, ways in (
        ({"posture": {"turn": 2.8}}, [-0.2, 0.2, 0.08, 0.008]),
        ({"limits": False}, [0.2, 0.2, 0.1, 0.1]),
    ):
        start, end = sc.scenes.from_file(ARM, **options).reference.jet(np.array([0.0, 2.0]), 0)[:, 0]
        np.testing.assert_allclose(end - start, ways, rtol=1e-12)


def test_elastic_inputs_are_the_closed_form_and_tend_to_the_rigid_ones() -> None:
    # u = tau + B (q'' + tau''/K), with tau, which is D q' too, of the rigid arm.
    scenes = {K: sc.scenes.from_file(ARM, posture=TURNS, elastic=dict.fromkeys(TURNS, sc.Elastic(K, 0.2)) if K else {})
              for K in (0.0, 1e3, 1e5)}  # fmt: skip
    times, step = np.array([0.4, 0.9, 1.5]), 5e-3
    rigid, jets = sc.ExactInversion(scenes[0.0]), scenes[0.0].reference.jet(times, 2)
    around = np.array([rigid(times + k * step) for k in range(-8, 9)])
    second = np.tensordot(np.convolve(DIFFERENCE, DIFFERENCE), around, 1) / step**2
    motors = np.array([0.2, 0.2, 0.2, 0.0])
    for K in (1e3, 1e5):
        exact = around[8] + motors * (jets[:, 2] + second / K)
        assert np.abs(sc.ExactInversion(scenes[K])(times) - exact).max() < 1e-9 * np.abs(exact).max()
    report = sc.analyse(scenes[1e3])
    assert (report.classification, report.index) == ("flat", 5)
    # None is given: no parameter is without effect.
    assert not any("damping" in name for name in scenes[1e3].parameter_values())


@pytest.mark.parametrize(("name", "options"), [
    ("arm.urdf", {"locked": ["left"]}),
    ("gantry.xml", {"outputs": ["load"], "ropes": ["load"], "posture": {"hoist": 4.0}}),
])  # fmt: skip
def test_mujoco_follows_the_path_under_the_inputs(name: str, options: Any, tmp_path: Path) -> None:
    text = re.sub(r'(<joint name="(left|right)" type=)"\w+"', r'\1"fixed"', (OWN / name).read_text())
    (tmp_path / name).write_text(text)
    assert simulated_stray(tmp_path / name, sc.scenes.from_file(OWN / name, **options)) < 1e-3


OVERHEAD = [
    (r'(?s)<body name="bridge">.*?(?=<body name="trolley">)', ""),
    ('name="s_y" type="slide" axis="0 1 0"', 'name="s" type="slide" axis="1 0 0"'),
    (r'<joint name="swing_y".*?/>', ""),
    (r"</body>\s*</worldbody>", "</worldbody>"),
    (r'<motor name="bridge.*?/>', ""),
    ('joint="s_y"', 'joint="s"'),
]  # fmt: skip
SLEWING = [
    ('name="s_x" type="slide" axis="1 0 0"', 'name="phi" axis="0 0 1"'),
    ('mass="40" diaginertia="1 1 1"', 'mass="1" diaginertia="480 480 480"'),
    ('type="slide" axis="0 1 0"', 'type="slide" axis="1 0 0"'),
    ('mass="10" diaginertia="1 1 1"', 'mass="10" diaginertia="1e-9 1e-9 1e-9"'),
    ('joint="s_x"', 'joint="phi"'),
]  # fmt: skip
CRANES: dict[str, tuple[Callable[[], sc.Scene], list[tuple[str, str]], dict[str, float], list[str]]] = {
    "gantry": (sc.scenes.gantry_crane, [], {"hoist": 5.0}, ["load"]),
    "overhead": (sc.scenes.overhead_crane, OVERHEAD, {"hoist": 4.0}, ["load.x", "load.z"]),
    "rotary": (sc.scenes.rotary_crane, SLEWING, {"hoist": 5.0, "s_y": 4.0}, ["load"]),
}


@pytest.mark.parametrize("form", ["ropes", "points"])
@pytest.mark.parametrize("name", CRANES)
def test_cranes_of_the_library_written_as_mjcf_have_their_closed_form(name: str, form: str, tmp_path: Path) -> None:
    peer("mujoco")
    factory, changes, posture, outputs = CRANES[name]
    # A load of 100 kg: of its body, of a frame that is fixed to it, and of a payload on that.
    block = '<body name="block"><inertial pos="0 0 0" mass="30" diaginertia="1 1 1"/></body></body>'
    text = (OWN / "gantry.xml").read_text().replace('mass="100"', 'mass="60"').replace("</body>", block, 1)
    for pattern, replacement in changes:
        text = re.sub(pattern, replacement, text)
    (tmp_path / "crane.xml").write_text(text)
    crane = factory()
    options: dict[str, Any] = {"posture": posture, form: ["load"], "payload": {"block": 10.0}}
    scene = sc.scenes.from_file(tmp_path / "crane.xml", outputs, crane.reference, **options)
    assert [each.name for each in scene.model().observables if each.tension] == (form == "ropes") * ["load.tension"]
    times = np.linspace(crane.reference.start_time, crane.reference.end_time, 41)
    ours, exact = sc.ExactInversion(scene)(times), crane.exact(times)
    for column, each in zip(ours.T, crane.model().inputs, strict=True):
        size = 0.1 if each.name == "M_w" else 1.0  # N m of the winch for a newton in the rope
        assert apart([(size * column, exact[each.name])]) < 1e-9
    if form == "ropes":  # at rest the rope carries the load of 100 kg
        assert sc.solve(scene, step=crane.reference.duration / 100)["load.tension"][0] == pytest.approx(981.0)


def test_names_order_and_split_links_change_nothing(tmp_path: Path) -> None:
    half = "<inertial><origin xyz='{}'/><mass value='1'/><inertia ixx='0.002'/></inertial>"
    text = re.sub(r'(?s)<inertial><origin xyz="0.2 0 0"/>.*?</inertial>', half.format("0.1 0 0"), ARM.read_text())
    text = text.replace(
        "</robot>",
        f"<link name='end'>{half.format('0 0 0')}</link><joint name='seam' type='fixed'>"
        "<parent link='fore'/><child link='end'/><origin xyz='0.3 0 0' rpy='1 0 0'/></joint></robot>",
    )
    other = ElementTree.fromstring(re.sub(r"""(?<=["'])(?=(turn|elbow|upper|fore|wrist)["'])""", "a ", text))
    other[:] = reversed(other)
    ElementTree.ElementTree(other).write(tmp_path / "other.urdf")
    scenes = [sc.scenes.from_file(path) for path in (ARM, tmp_path / "other.urdf")]
    runs = [(sc.solve(scene, step=0.05), scene.model().inputs) for scene in scenes]
    inputs = [{each.name.removeprefix("a "): run[each.name] for each in names} for run, names in runs]
    assert apart([(inputs[0][name], inputs[1][name]) for name in inputs[0]]) < 1e-12


def test_an_sdf_slider_crank_moves_and_takes_the_power_as_by_hand() -> None:
    scene = sc.scenes.from_file(OWN / "loop.sdf", ["turn"], inputs=["turn"], posture={"turn": 0.7})
    solution = sc.solve(scene, step=0.005)
    a = solution["turn"]
    rod = np.arcsin(-0.4 * np.sin(a))  # its angle from the line of the slider; both turn about y
    places = {"crank": 0.1 * np.exp(-1j * a), "rod": 0.2 * np.exp(-1j * a) + 0.25 * np.exp(-1j * rod)}
    slider = 0.2 * np.cos(a) + 0.5 * np.cos(rod)
    assert np.abs(solution["slide"] - (slider - 0.7)).max() < 1e-14

    def rate(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, DIFFERENCE[::-1], "valid") / 0.005

    # The pose of the model turns its x upwards.
    energy = 0.5 * (0.004 * rate(a) ** 2 + 0.03 * rate(rod) ** 2 + 2.0 * rate(slider) ** 2) + 19.6 * slider[4:-4]
    for name, mass in (("crank", 1.0), ("rod", 1.5)):
        energy = energy + mass * (0.5 * np.abs(rate(places[name])) ** 2 + 9.8 * places[name].real[4:-4])
    power = rate(energy) + 2.0 * rate(slider)[4:-4] ** 2
    assert apart([(power, solution["turn.torque"][8:-8] * rate(a)[4:-4])]) < 1e-8


@pytest.mark.parametrize(("name", "options", "hint"), [
    ("gantry.xml", {"outputs": ["load"], "posture": {"hoist": 4.0}}, "ropes=['load'] replaces swing_y, swing_x by its"),
    ("drone.xml", ALOFT | {"inputs": ["front", "left", "rear", "right"]}, ""),
    ("drone.xml", {"outputs": ["drone.x", "drone.y", "drone.z", "drone.rz"]}, f"inputs={WRENCH} takes the wrench"),
])  # fmt: skip
def test_analyse_names_options_that_show_flatness(name: str, options: Any, hint: str) -> None:
    peer("mujoco")
    report = sc.analyse(sc.scenes.from_file(OWN / name, **options))
    assert hint in report.advice
    assert (report.classification == "flat") == (not hint)


def test_rotors_share_the_wrench_on_a_drone_with_a_load() -> None:
    peer("mujoco")
    scene = sc.scenes.from_file(OWN / "drone.xml", **ALOFT, inputs=WRENCH)
    report, solution = sc.analyse(scene), sc.solve(scene)
    assert (report.classification, report.index) == ("flat", 7)
    thrust = np.sum([solution[f"{name}.drive"] for name in ("front", "left", "rear", "right")], axis=0)
    assert apart([(thrust, solution["drone.force_z"])]) < 1e-13
    assert solution["rope.tension"].min() > 0.0


def test_joints_that_an_equality_couples_and_a_tendon_moves_take_the_force_of_both(tmp_path: Path) -> None:
    """y = 2 x + x^2: the tendon, at the rate of x, moves 2 kg by x'' and 3 kg by y'' = (2 + 2 x) x'' + 2 x'^2."""
    peer("mujoco")
    bodies = "".join(
        f"<body name='{name}_'><joint name='{name}' type='slide' axis='1 0 0'/>"
        f"<inertial pos='0 0 0' mass='{mass}' diaginertia='1 1 1'/></body>"
        for name, mass in (("x", 2), ("y", 3))
    )
    (tmp_path / "two.xml").write_text(
        f"<mujoco><worldbody>{bodies}</worldbody>"
        "<equality><joint joint1='y' joint2='x' polycoef='0 2 1 0 0'/></equality>"
        "<tendon><fixed name='t'><joint joint='x' coef='1'/></fixed></tendon>"
        "<actuator><motor name='pull' tendon='t' gear='7'/></actuator></mujoco>"
    )
    scene = sc.scenes.from_file(tmp_path / "two.xml", ["x"])
    solution = sc.solve(scene, step=0.25)
    x, rate, a = scene.reference.jet(solution.t, 2)[:, :, 0].T
    pulled = 2 * a + 3 * (2 + 2 * x) * ((2 + 2 * x) * a + 2 * rate**2)
    assert apart([(solution["y"], 2 * x + x**2), (solution["pull.force"], pulled)]) < 1e-12


def test_the_drawing_of_a_file_shows_joints_ropes_and_what_follows_the_path() -> None:
    peer("mujoco")
    scene = sc.scenes.from_file(OWN / "gantry.xml", ["load"], ropes=["load"], posture={"hoist": 4.0})
    system = scene.model()
    parts = present(scene.drawing)(dict(zip(system.coordinates.names, ca.vertsplit(system.q), strict=True)))
    assert {part.kind for part in parts} == {"pin", "bar", "rope", "body"}
    assert [part.name for part in parts if part.kind == "body"] == ["load"]
    ((trolley, load),) = ([ca.vertcat(*point) for point in part.points] for part in parts if part.kind == "rope")
    rope = ca.Function("rope", [system.q], [load - trolley])(system.home_configuration()[0])
    np.testing.assert_allclose(np.asarray(rope).ravel(), [0.0, 0.0, -4.0], atol=1e-12)


def mjcf(rest: str) -> str:
    """Return a body on a hinge with further elements."""
    body = "<body name='b'><joint name='j' axis='0 1 0'/><geom name='g' size='0.1'/></body>"
    return f"<mujoco><worldbody>{body}</worldbody>{rest}</mujoco>"


BROKEN = {
    "truncated": (r"(?s)</joint>.*", "", "is no well-formed XML: line 23, column 102: no element found"),
    "cycle": ('<parent link="base"/>', '<parent link="tool"/>', "form a cycle"),
    "two roots": (r'<joint name="mount" .*?</joint>', "", "2 root links, base, tool"),
    "missing link": ('<child link="fore"/>', '<child link="four"/>', "joint name='elbow'> joins the link four"),
    "second parent": ('<child link="tool"/>', '<child link="fore"/>', "gives fore a second parent, beside joint elbow"),
    "negative mass": ('value="2.0"', 'value="-2.0"', "body fore has the negative mass -2 kg"),
    "inertia": ('iyy="0.02"', 'iyy="0.2"', "body fore, .* no distribution of mass"),
    "millimetres": (r'xyz="0.05 0 0.3"', 'xyz="50 0 301"', "body fore is 305.* m from its parent: .* millimetres"),
    "kg mm2": ('ixx="0.004"(.*)iyy="0.02"(.*)izz="0.02"', r'ixx="4e3"\1iyy="2e4"\2izz="2e4"', "fore has a radius of"),
    "no number": ('value="3.0"', 'value="3,0"', "link name='upper'> holds '3,0' where 1 finite number"),
    "bomb": ("<robot", '<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot', "<!DOCTYPE r> declares"),
    "external entity": ("<robot", '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot', "<!DOCTYPE r> declares"),
    "mimic": ('joint="left"', 'joint="right"', "joint right mimics right, which is itself"),
    "axis": ('xyz="0 2 0"', 'xyz="0 0 0"', "joint name='elbow'> has an axis of length zero"),
    "xacro": ("<link", '<xacro:link xmlns:xacro="x" name="a"/><link', "xacro: run xacro"),
    "other root": ("robot(.*)robot", r"model\1model", "is no robot file"),
    "degrees": (".*", "<sdf><link><pose degrees='true'/></link></sdf>", "<pose> has degrees='true', which is not"),
    "no gravity": (".*", "<sdf><model name='m'><link name='a'><gravity>0</gravity></link></model></sdf>", "> false, "),
    "mesh": (".*", "<mujoco><asset><mesh name='m' file='../m'/></asset></mujoco>", "names ../m, which is outside"),
    "include": (".*", "<mujoco><include file='/etc/passwd'/></mujoco>", "names /etc/passwd, which is outside"),
    "plugin": (".*", mjcf("<extension><plugin plugin='p'/></extension>"), "is a plugin, which cannot be represented"),
    "flags": (".*", mjcf("<option><flag spring='disable'/></option>"), "its flags disable springs: delete these"),
    "gear": (".*", mjcf("<actuator><motor joint='j' gear='0'/></actuator>"), "actuator j.drive has a gear of zero"),
    "adhesion": (".*", mjcf("<actuator><adhesion body='b' ctrlrange='0 1'/></actuator>"), "acts on something else"),
    "user": (".*", mjcf("<actuator><general name='a' joint='j' dyntype='user'/></actuator>"), "a is no motor and no"),
    "type": ('name="turn" type="revolute"', 'name="turn" type="spherical"', "has the type spherical; there are"),
    "limits": ('lower="-3"', 'lower="9"', "has the lower limit 9 above the upper 3"),
    "two models": ("</sdf>", "<model name='m'/></sdf>", "has 2 models, one is read", "loop.sdf"),
    "frame": ("<pose>0.7", "<pose relative_to='rod'>0.7", "refers to another frame or file", "loop.sdf"),
    "sliding loop": ('type="ball"', 'type="prismatic"', "closes a loop by the type prismatic", "loop.sdf"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_in_one_sentence_with_file_and_element(name: str, tmp_path: Path) -> None:
    pattern, replacement, sentence, *of = BROKEN[name]
    if "actuator" in replacement or "option" in replacement:
        peer("mujoco")
    text, count = re.subn(pattern, replacement, (OWN / of[0] if of else ARM).read_text(), count=1, flags=re.DOTALL)
    assert count
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(sc.InvalidModel, match=f"^arm.urdf.*{sentence}") as refusal:
        sc.scenes.from_file(tmp_path / "arm.urdf")
    assert "\n" not in str(refusal.value)


def broken(text: str, rng: np.random.Generator) -> str:
    """Return a file cut off, without an element or an attribute, or with another value in an attribute."""
    tag, one, other, attribute = (
        rng.choice(np.array([each.span() for each in re.finditer(pattern, text)]))
        for pattern in (r"<[^!?][^>]*>", r'"[^"]*"', r'"[^"]*"', r'\s\w+="[^"]*"')
    )
    values = ['""', '"nan"', '"1e308 -1e308 1e308"', '"-1"', '"x"', '"../../x"', '"0 0 0"', text[slice(*other)]]
    begin, end, instead = (
        (int(rng.integers(len(text))), len(text), ""), (*tag, ""), (*attribute, ""), (*one, str(rng.choice(values)))
    )[int(rng.integers(4))]  # fmt: skip
    return f"{text[:begin]}{instead}{text[end:]}"


def test_a_drive_that_moves_no_mass_is_warned_of(tmp_path: Path) -> None:
    hand = "<link name='hand'/><joint name='grip' type='continuous'><parent link='tool'/><child link='hand'/></joint>"
    (tmp_path / "hand.urdf").write_text(ARM.read_text().replace("</robot>", f"{hand}</robot>"))
    with pytest.warns(sc.errors.ServocoreWarning, match="^hand.urdf: grip moves no mass, its drive does nothing"):
        assert not sc.solve(sc.scenes.from_file(tmp_path / "hand.urdf"))["grip.torque"].any()
    sc.scenes.from_file(tmp_path / "hand.urdf", locked=["grip"])


@pytest.mark.parametrize("batch", thinned(range(10), lambda batch: batch == 0))
@pytest.mark.parametrize("name", ["arm.urdf", "gantry.xml", "drone.xml", "fourbar.xml", "loop.sdf"])
def test_files_broken_by_chance_are_read_or_refused_within_a_second(name: str, batch: int, tmp_path: Path) -> None:
    path, text = tmp_path / name, (OWN / name).read_text()
    if name.endswith("xml"):
        peer("mujoco")
    for seed in range(40 * batch, 40 * batch + 40):
        path.write_text(broken(text, np.random.default_rng(seed)))
        begin, told = time.process_time(), ""
        try:
            sc.scenes.from_file(path)
        except sc.ServocoreError as refusal:
            told = str(refusal)
        assert "\n" not in told
        assert time.process_time() - begin < 1.0


def test_a_free_base_of_a_urdf_takes_a_wrench_as_that_of_an_mjcf_does(tmp_path: Path) -> None:
    peer("mujoco")
    urdf = """<robot name="drone"><link name="world"/><link name="drone"><inertial>
    <mass value="1.5"/><inertia ixx="0.03" iyy="0.04" izz="0.05"/></inertial></link><joint name="pose"
    type="floating"><parent link="world"/><child link="drone"/><origin xyz="0 0 2"/></joint></robot>"""
    mjcf = """<mujoco><worldbody><body name="drone" pos="0 0 2"><freejoint name="pose"/><inertial pos="0 0 0"
    mass="1.5" diaginertia="0.03 0.04 0.05"/></body></worldbody></mujoco>"""
    runs = []
    for name, text in (("drone.urdf", urdf), ("drone.xml", mjcf)):
        (tmp_path / name).write_text(text)
        with pytest.raises(sc.InvalidSetting, match=f"{name} has no drive: name inputs"):
            sc.scenes.from_file(tmp_path / name)
        outputs = [*(f"drone.{axis}" for axis in "xyz"), "drone.rz"]
        scene = sc.scenes.from_file(tmp_path / name, outputs, inputs=WRENCH)
        report = sc.analyse(scene)
        assert (report.classification, report.index) == ("flat", 5)
        runs.append(sc.solve(scene.with_reference(sc.rest_to_rest((0, 0, 2, 0), (1, 0.5, 3, 1), 3.0, sc.DEGREE13))))
    assert apart([(runs[0][name], runs[1][name]) for name in WRENCH]) < 1e-12


@pytest.mark.parametrize(("options", "sentence"), [
    ({"outputs": ["tools"]}, "there is no frame tools; there are base, upper"),
    ({"outputs": "tool"}, "outputs must be a list of names, not 'tool'"),
    ({"outputs": ["tool"]}, r"3 outputs \(tool.x, tool.y, tool.z\) need as many inputs, not 4 \(turn.torque"),
    ({"outputs": ["turn", "tool.x", "tool.y", "left"]}, "turn, tool.x, tool.y, left are dependent at the posture"),
    ({"passive": ["shoulder"]}, "passive: arm.urdf has no joint shoulder"),
    ({"elastic": {"turn": sc.Elastic(1e3)}}, "turn needs a motor inertia, for arm.urdf states no armature"),
    ({"elastic": {"right": sc.Elastic(1e3, 0.1)}}, "right is a mimic"),
    ({"inputs": ["turn", "turn"]}, "turn.torque stands twice"),
    ({"ropes": ["wrist"]}, "wrist cannot hang on a rope: no hinge without a drive"),
    ({"gravity": [0, 9.81]}, "gravity must be three numbers"),
    ({"inputs": ["turn.force"]}, "has no joint or drive turn.force; there are turn"),
    ({"posture": {"right": 0.01}}, "posture: right follows left: name that one"),
    ({"limits": "no"}, "limits must be true or false, not the text 'no'"),
    ({"payload": {"tool": -1.0}}, "tool.payload = -1 kg is outside its range"),
])  # fmt: skip
def test_a_wrong_option_is_refused_with_what_there_is(options: Any, sentence: str) -> None:
    with pytest.raises(sc.ServocoreError, match=sentence):
        sc.scenes.from_file(ARM, **options)


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A file and settings for it, as commands take them."""
    monkeypatch.chdir(tmp_path)
    Path("arm.toml").write_text(
        'locked = ["left"]\n[payload]\ntool = 2.0\n[elastic]\nturn = 1e3\nelbow = { stiffness = 2e3 }\n'
    )
    return [str(ARM), "--import", "arm.toml", "--motor-inertia", "0.3"]


def test_import_shows_what_a_file_and_settings_make(words: list[str]) -> None:
    shown = servocore("import", *words)
    listed = "elastic hinge,locked slide,mimics left,turn.torque (N.m),0 is taken for none,right: it follows left"
    assert all(each in shown.stdout for each in listed.split(","))


@pytest.mark.parametrize("elastic", [True, False])
def test_commands_take_files_and_settings(words: list[str], elastic: bool) -> None:
    if not elastic:
        text, words = Path("arm.toml").read_text(), words[:3]
        Path("arm.toml").write_text(text.partition("[elastic]")[0])
    assert servocore("feedforward", *words, "-o", "inputs.csv").exit_code == 0
    assert Path("inputs.csv").read_text().startswith("time,turn.torque,elbow.torque,extend.force,turn,elbow,extend\n")


@pytest.mark.usefixtures("empty_folder")
def test_lines_of_the_page_on_robots_run() -> None:
    page = (OWN.parents[1] / "docs" / "howto" / "import-robots.md").read_text()
    Path("settings.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    for line in re.findall(r"^\$ servocore (import [^#\n]*)", page, re.MULTILINE):
        assert servocore(*line.replace("ur5.urdf", str(UR5)).split()).exit_code == 0


def test_sweeps_take_files_and_settings(words: list[str]) -> None:
    swept = ["--vary", "duration=2..3:2", "--vary", "turn.stiffness=1e3..2e3:2", "-o", "cases"]
    assert "4 cases, 0 of them not solved" in servocore("sweep", *words, *swept).stdout  # rates have margins too


def test_commands_refuse_settings_that_a_file_cannot_have() -> None:
    for wrong, sentence in (
        (["rotary_crane", "--elastic", "1e4"], "is no URDF, MJCF or SDF file: elastic cannot"),
        ([str(ARM), "--elastic", "0"], "is no stiffness"),
        ([str(ARM), "--motor-inertia", "0.3"], "motor_inertia is that of elastic joints, and there are none"),
    ):
        servocore.assert_refused(servocore("analyse", *wrong), sentence)
