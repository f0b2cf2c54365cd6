"""MJCF: mechanisms from the model that MuJoCo itself compiles: defaults, frames and inertias are its business.

Coordinates are those of MuJoCo, but for balls and free bodies, whose quaternions count from the file's orientation.
Limits, servo gains and rest positions become limits, observables and potentials; equality constraints are exact here,
and soft in MuJoCo.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from servocore.errors import InvalidModel, extra
from servocore.importers.tree import FREE, GROUND, IDENTITY, LARGEST, Actuator, Body, Closure, Joint, Tendon, Tree
from servocore.importers.xml_files import XmlFile
from servocore.numerics.compiled_calls import Array

_FOLDERS = ("meshdir", "texturedir", "assetdir")
_SINGLE = ("slide", "hinge")
_DRIVEN = {"joint": "joint", "tendon": "tendon", "site": "frame"}


def read_mjcf(file: XmlFile) -> Tree:
    """Return the tree of an MJCF file.

    Parameters
    ----------
    file : XmlFile
        With the root ``mujoco``; URDF files that MuJoCo reads are accepted as well.

    Returns
    -------
    Tree
        With sites as frames.

    Raises
    ------
    InvalidModel
        If MuJoCo refuses the file, a path leads out of its folder, or an element cannot be represented; with its name.
    InvalidSetting
        If the package mujoco is missing.
    """
    _require_inside(file, file.path.parent.resolve(), {file.path.resolve()})
    mujoco = extra("mujoco")
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # MuJoCo's own writes a file into the current folder
    try:
        model = mujoco.MjModel.from_xml_path(str(file.path))
    except ValueError as error:
        raise InvalidModel(f"{file.path.name}: MuJoCo refuses it: {' '.join(str(error).split())}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    return _Reader(file, model, mujoco).tree()


def _require_inside(file: XmlFile, folder: Path, read: set[Path]) -> None:
    """Refuse paths that lead out of the folder of the first file, in included files too."""
    folders = [str(each.get(name)) for each in file.root.iter() for name in _FOLDERS if each.get(name)]
    for element in file.root.iter():
        if element.tag in ("plugin", "extension"):
            raise file.fault(element, "is a plugin, which cannot be represented")
        for path in [value for name, value in element.attrib.items() if name.startswith("file") or name in _FOLDERS]:
            for base in ("", *folders):
                if not (folder / base / path).resolve().is_relative_to(folder):
                    raise file.fault(element, f"names {path}, which is outside the folder of {file.path.name}")
        if element.tag in ("include", "model", "attach") and element.get("file"):
            other = (folder / str(element.get("file"))).resolve()
            if other not in read and other.suffix != ".obj":
                read.add(other)
                _require_inside(XmlFile.read(other), folder, read)


class _Reader:
    def __init__(self, file: XmlFile, model: Any, mujoco: Any) -> None:
        self.file, self.m, self.mujoco, self.left_out = file, model, mujoco, list[str]()
        self.bodies = [GROUND, *(model.body(k).name or f"body{k}" for k in range(1, model.nbody))]
        self.joints = [
            model.joint(k).name or f"{self.bodies[body]}.joint{k - model.body_jntadr[body]}"
            for k, body in enumerate(model.jnt_bodyid)
        ]
        names = [model.site(k).name or f"site{k}" for k in range(model.nsite)]
        self.sites = [f"{name}.site" if name in self.bodies else name for name in names]
        self.tendons = [model.tendon(k).name or f"tendon{k}" for k in range(model.ntendon)]
        self.frames = [
            Body(name, self.bodies[model.site_bodyid[k]], model.site_pos[k].copy(), self._rotation(model.site_quat[k]))
            for k, name in enumerate(self.sites)
        ]

    def fault(self, sentence: str) -> InvalidModel:
        return InvalidModel(f"{self.file.path.name}: {sentence}")

    def tree(self) -> Tree:
        m, root = self.m, self.file.root
        self._require_representable()
        self._list_left_out()
        weightless = m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        gravity = np.zeros(3) if weightless else m.opt.gravity
        name = (root.get("model") or root.get("name") or self.file.path.stem).replace(" ", "_")
        tendons = {each: self._tendon(k, each) for k, each in enumerate(self.tendons)}
        actuators = [self._actuator(k) for k in range(m.nu)]
        joints = [each.on for each in actuators if each.kind == "joint"]
        for each in (each for each in actuators if joints.count(each.on) > 1):
            self.left_out.append(f"gain and limits of actuator {each.name}: joint {each.on} has another drive")
        closures = [closure for k in range(m.neq) for closure in self._closure(k)]
        bodies = [*(self._body(k) for k in range(1, m.nbody)), *self.frames]
        return Tree(name, self.file.path.name, bodies, actuators, tendons, closures, gravity.tolist(), self.left_out)

    def _kind(self, of: str, value: int) -> str:
        """Return the name of a value of an enumeration of MuJoCo, in small letters."""
        return str(getattr(self.mujoco, f"mjt{of}")(int(value)).name).partition("_")[2].lower()

    def _rotation(self, quaternion: Array) -> Array:
        matrix = np.zeros(9)
        self.mujoco.mju_quat2Mat(matrix, quaternion)
        return matrix.reshape(3, 3)

    def _require_representable(self) -> None:
        """Refuse elements that change the motion and have no counterpart."""
        m, bits = self.m, self.mujoco.mjtDisableBit
        if m.nflex:
            raise self.fault("it holds a flex, which cannot be represented")
        for flag, what in (("SPRING", "springs"), ("DAMPER", "dampers"), ("EQUALITY", "equality")):
            if m.opt.disableflags & int(getattr(bits, f"mjDSBL_{flag}", 0)):
                raise self.fault(f"its flags disable {what}: delete these elements instead")
        listed = (
            ("body_gravcomp", self.bodies, "compensates gravity"),
            ("jnt_stiffnesspoly", self.joints, "has a nonlinear spring"),
            ("dof_dampingpoly", [self.joints[k] for k in m.dof_jntid], "has a nonlinear damper"),
            ("tendon_stiffnesspoly", self.tendons, "has a nonlinear spring"),
            ("tendon_dampingpoly", self.tendons, "has a nonlinear damper"),
            ("tendon_armature", self.tendons, "has armature"),
            ("actuator_dampingpoly", [m.actuator(k).name for k in range(m.nu)], "has a nonlinear damper"),
        )
        for attribute, names, what in listed:
            for k in np.flatnonzero(np.atleast_2d(getattr(m, attribute, np.zeros(0)).T).any(axis=0)):
                raise self.fault(f"{attribute.partition('_')[0]} {names[k]} {what}, which cannot be represented")

    def _body(self, k: int) -> Body:
        m = self.m
        axes, rotation = self._rotation(m.body_iquat[k]), self._rotation(m.body_quat[k])
        joints = [joint for j in np.flatnonzero(m.jnt_bodyid == k) for joint in self._joint(int(j), rotation)]
        inertia = axes @ np.diag(m.body_inertia[k]) @ axes.T
        return Body(
            self.bodies[k], self.bodies[m.body_parentid[k]], np.array(m.body_pos[k]), rotation, float(m.body_mass[k]),
            np.array(m.body_ipos[k]), inertia, tuple(joints),
        )  # fmt: skip

    def _joint(self, j: int, rotation: Array) -> list[Joint]:
        """Return the elementary joints of a joint of a body with this rotation in its parent's axes."""
        m, name, kind = self.m, self.joints[j], self._kind("Joint", self.m.jnt_type[j])
        dof, place = int(m.jnt_dofadr[j]), int(m.jnt_qposadr[j])
        same: Any = {"damping": float(m.dof_damping[dof]), "armature": float(m.dof_armature[dof])}
        if kind not in _SINGLE:
            if m.jnt_stiffness[j]:
                raise self.fault(f"joint {name} has a spring, which a ball or a free body cannot have here")
            if m.jnt_limited[j]:
                self.left_out.append(f"limit of joint {name}: a ball has none")
            free = Joint.free(name, rotation, m.qpos0[place : place + 3], **same)
            return free if kind == "free" else [replace(free[-1], anchor=np.array(m.jnt_pos[j]))]
        lower, upper = self._range("jnt_", j)
        return [Joint(
            name, kind, np.array(m.jnt_axis[j]), np.array(m.jnt_pos[j]), lower, upper,
            effort=max(map(abs, self._range("jnt_actfrc", j))), stiffness=float(m.jnt_stiffness[j]),
            rest=float(m.qpos_spring[place]), zero=float(m.qpos0[place]), **same,
        )]  # fmt: skip

    def _tendon(self, k: int, name: str) -> Tendon:
        m, terms, branches, refusal = self.m, dict[str, float](), [(1.0, list[str]())], ""
        for w in range(m.tendon_adr[k], m.tendon_adr[k] + m.tendon_num[k]):
            kind, place, value = self._kind("Wrap", m.wrap_type[w]), int(m.wrap_objid[w]), float(m.wrap_prm[w])
            if kind == "joint":
                terms[self.joints[place]] = value
            elif kind == "pulley":
                branches.append((value, []))
            elif kind == "site":
                branches[-1][1].append(self.sites[place])
            else:
                refusal = f"wraps around the geom {m.geom(place).name or place}, which cannot be represented"
        low, high = m.tendon_lengthspring[k].tolist()
        slack = low != high and m.tendon_stiffness[k]
        if m.tendon_limited[k]:
            self.left_out.append(f"range of tendon {name}, unless it is taut=['{name}']")
        return Tendon(
            name, terms, [] if terms else branches, float(m.tendon_stiffness[k]), math.nan if slack else low,
            float(m.tendon_damping[k]), self._range("tendon_", k)[1], refusal,
        )  # fmt: skip

    def _closure(self, k: int) -> list[Closure]:
        """Return an equality constraint; none where it is not active."""
        m, kind = self.m, self._kind("Eq", self.m.eq_type[k])
        name, data = m.eq(k).name or f"equality{k}", m.eq_data[k]
        first, second = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
        if not m.eq_active0[k]:
            self.left_out.append(f"equality {name}, which is not active")
            return []
        if kind not in ("joint", "tendon", "connect", "weld"):
            raise self.fault(f"equality {name} has a type that cannot be represented")
        if kind in ("joint", "tendon"):
            of, values = (self.joints, m.qpos0[m.jnt_qposadr]) if kind == "joint" else (self.tendons, m.tendon_length0)
            rest = (float(values[first]), float(values[second]) if second >= 0 else 0.0)
            return [Closure(name, kind, of[first], of[second] if second >= 0 else "", tuple(data[:5]), rest)]
        if self._kind("Obj", m.eq_objtype[k]) == "site":
            return [Closure(name, kind, self.sites[first], self.sites[second])]
        # A weld lists the point on the second body before the pose in the first one, a connect the other way round.
        one, other = (data[3:6], data[:3]) if kind == "weld" else (data[:3], data[3:6])
        relative = self._rotation(data[6:10]) if kind == "weld" else IDENTITY
        self.frames.append(Body(f"{name}.1", self.bodies[first], one.copy(), relative))
        self.frames.append(Body(f"{name}.2", self.bodies[second], other.copy()))
        return [Closure(name, kind, f"{name}.1", f"{name}.2")]

    def _actuator(self, k: int) -> Actuator:
        m, gear, (target, reference) = self.m, tuple(self.m.actuator_gear[k].tolist()), self.m.actuator_trnid[k]
        on = self._kind("Trn", m.actuator_trntype[k]).removesuffix("inparent")
        turned = on == "joint" and self._kind("Joint", m.jnt_type[target]) not in _SINGLE
        if on not in _DRIVEN or turned or (on == "site" and reference >= 0):
            name = m.actuator(k).name or k
            raise self.fault(f"actuator {name} acts on something else than a hinge, a slide, a tendon or a site")
        where, place = _DRIVEN[on], getattr(self, f"{on}s")[target]
        name = m.actuator(k).name or f"{place}.drive"
        if not 0.0 < np.abs(gear if where == "frame" else gear[:1]).max() < LARGEST:
            raise self.fault(f"actuator {name} has a gear of zero, or above {LARGEST:g}")
        kinds = (self._kind(of, getattr(m, f"actuator_{of.lower()}type")[k]) for of in ("Gain", "Bias", "Dyn"))
        gain, biased, dynamics = kinds
        if gain != "fixed" or biased not in ("none", "affine") or dynamics in ("muscle", "user"):
            raise self.fault(f"actuator {name} is no motor and no position or velocity servo: it cannot be represented")
        for attribute in ("actuator_armature", "actuator_damping"):
            if getattr(m, attribute, np.zeros(m.nu))[k]:
                raise self.fault(f"actuator {name} has {attribute[9:]}: give it to the joint instead")
        if dynamics != "none":
            self.left_out.append(f"dynamics of actuator {name}: the input is its force")
        limits, control = (self._range(f"actuator_{what}", k) for what in ("force", "ctrl"))
        behind = self._range("jnt_actfrc" if where == "joint" else f"{where}_actfrc", target)
        bias = tuple(m.actuator_biasprm[k][:3].tolist()) if biased == "affine" else (0.0, 0.0, 0.0)
        return Actuator(name, where, place, gear, float(m.actuator_gainprm[k][0]), bias, limits, control, behind)

    def _list_left_out(self) -> None:
        """List elements without a part in the model."""
        m = self.m
        if m.ngeom and (m.geom_contype.any() or m.geom_conaffinity.any()):
            self.left_out.append("contact between geoms")
        rubbing = [self.joints[m.dof_jntid[k]] for k in np.flatnonzero(m.dof_frictionloss)]
        rubbing += [self.tendons[k] for k in np.flatnonzero(m.tendon_frictionloss)]
        self.left_out += [f"dry friction of {name}" for name in rubbing]
        if m.opt.density or m.opt.viscosity:
            self.left_out.append("forces of the fluid")

    def _range(self, what: str, k: int) -> tuple[float, float]:
        """Return the bounds of an element, infinite where it is not limited, or none are known to MuJoCo's version."""
        limited = getattr(self.m, f"{what}limited", None)
        low, high = getattr(self.m, f"{what}range")[k] if limited is not None and limited[k] else FREE
        return float(low), float(high)
