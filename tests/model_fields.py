"""Every field of MuJoCo's models, and what `physics: tree` makes of it; a model in which most have an effect."""

from pathlib import Path

import mujoco
import numpy as np

IMU = "gyroscope", "accelerometer"

XML = (Path(__file__).parent / "data" / "fields.xml").read_text()
"""Two hinges with a foot on a plane, a ball on a slide that meets the foot, a tendon without effect, three motors."""


def of(prefix: str, names: str) -> tuple[str, ...]:
    """Names of fields that share a prefix."""
    return tuple(f"{prefix}_{name}" for name in names.split())


COMPUTED = (
    *("qpos0", "qpos_spring"),
    *of("body", "pos quat ipos iquat mass inertia invweight0"),
    *of("jnt", "pos axis stiffness range margin solref solimp actfrcrange"),
    *of("dof", "armature damping frictionloss solref solimp invweight0"),
    *of("geom", "pos quat size friction margin solref solimp solmix"),
    *of("pair", "friction margin solref solimp"),
    *of("actuator", "gear gainprm ctrlrange forcerange"),
    *of("opt", "timestep gravity impratio"),
)
"""Numbers. `tests/float64/test_model_fields.py` changes all of them and compares with native MuJoCo."""

CHOICES = (
    *of("jnt", "limited actfrclimited"),
    *of("geom", "priority condim contype conaffinity"),
    *of("actuator", "ctrllimited forcelimited"),
    *of("pair", "dim geom1 geom2"),
    *of("opt", "integrator cone disableflags enableflags disableactuator"),
)
"""Computed, or refused, as they are chosen: `CHOSEN` and tests of each flag."""

STRUCTURE = (
    *of("body", "parentid weldid rootid jntnum jntadr"),
    *of("jnt", "type qposadr dofadr bodyid"),
    *of("dof", "bodyid jntid parentid"),
    *of("geom", "type bodyid"),
    *of("site", "bodyid pos quat"),
    *of("sensor", "type objid adr dim"),
    *of("actuator", "trnid ctrladr outadr"),
    "exclude_signature",
)
"""Computed: tests/float64/test_tree.py, test_tree_features.py and test_zoo.py compare robots of many structures."""

REFUSED = {
    **dict.fromkeys(of("actuator", "armature damping dampingpoly delay"), 0.1),
    **dict.fromkeys(of("actuator", "gaintype biastype dyntype trntype"), 1),
    **dict.fromkeys(of("tendon", "stiffness stiffnesspoly damping dampingpoly frictionloss armature limited"), 1),
    **dict.fromkeys(("tendon_actfrclimited", "body_gravcomp", "jnt_springyield"), 1),
    **dict.fromkeys(("jnt_stiffnesspoly", "dof_dampingpoly"), 0.1),
    **dict.fromkeys(of("sensor", "cutoff delay interval"), 0.1),
}
"""Refused by name where they are not 0: values to refuse. Others that are refused have tests of their own."""

REFUSED_ELSEWHERE = (
    *of("geom", "gap adhesion surfacevel"),  # a pair's sentence names both shapes
    *of("pair", "gap adhesion"),
    *of("opt", "density viscosity noslip_iterations"),
    *("eq_type", "body_mocapid", "body_plugin", "geom_plugin", "actuator_plugin", "sensor_plugin"),
)

IDLE = (
    # They act through what is refused alone: other types of motors, activations, fluids, limits of
    # tendons, flags for overriding and sleeping, noslip, signed distance fields.
    *of("actuator", "dynprm biasprm cranklength actlimited actrange actearly acc0 length0 lengthrange group ctrlspec"),
    *("jnt_actgravcomp", "tree_sleep_policy"),
    "pair_solreffriction",  # acts in elliptic cones alone, and is refused there
    *of("tendon", "actfrcrange range margin solref_lim solimp_lim solref_fri solimp_fri lengthspring springyield"),
    *of("tendon", "type length0 invweight0 group width rgba"),
    *of("opt", "wind magnetic o_margin o_solref o_solimp o_friction sleep_tolerance sdf_initpoints sdf_iterations"),
    *of("opt", "noslip_tolerance ccd_iterations ccd_tolerance"),
    # How MuJoCo's solver gets to the minimum, which the tree finds by its own.
    "opt_jacobian",
    # Looks, notes, and sensors' noise, which MuJoCo does not add.
    *of("jnt", "group"),
    *of("geom", "group castshadow rgba"),
    *of("site", "group rgba size type"),
    *of("sensor", "noise intprm reftype datatype"),
    *of("stat", "center extent meaninertia meanmass meansize"),
    "wrap_prm",
)
"""They may be ignored: a test changes each, and native MuJoCo moves as before."""

SOLVER = of("opt", "solver iterations tolerance ls_iterations ls_tolerance")
"""They decide how near MuJoCo comes to the minimum, which the tree finds to rounding."""

DERIVED = (
    # MuJoCo's compiler makes these of the others, and no MJCF sets them apart.
    *of("body", "dofnum dofadr treeid geomnum geomadr simple sameframe subtreemass margin contype conaffinity"),
    *of("body", "bvhadr bvhnum"),
    *of("jnt", "actuatorid plasticadr"),
    *of("dof", "treeid Madr simplenum M0 length"),
    *of("geom", "dataid sameframe aabb rbound"),
    *of("site", "dataid sameframe"),
    *of("actuator", "actadr actnum ctrlnum outnum historyadr history"),
    *of("sensor", "needstage objtype refid historyadr history"),
    *of("tendon", "adr num actuatorid plasticadr treenum treeid"),
    *of("tree", "bodyadr bodynum dofadr dofnum"),
    *of("wrap", "type objid"),
    *("pair_signature", "signature", "geom_fluid"),  # geom_fluid: of the geom, and only for fluids
)

APART = {
    "looks": ("cam", "light", "mat", "tex", "skin", "vis"),
    "notes": ("name", "names", "key", "numeric", "text", "tuple", "paths"),
    "shapes of which no contact is taken": ("mesh", "hfield", "oct"),
    "parts of what is refused": ("flex", "flexedge", "plugin", "eq", "efm0", "efmC"),
    "layouts of arrays and search trees": ("bvh", "M", "B", "D", "mapM2D", "mapD2M", "mapM2M", "ten", "flg"),
}
"""Prefixes of other fields. Fields called `*_user`, `*_matid` and `n...` are notes, looks and sizes of arrays."""


def names_of(thing: object, prefix: str = "") -> list[str]:
    """The fields of a model, its options or its statistics."""
    return [prefix + name for name in dir(thing) if not name.startswith("_") and not callable(getattr(thing, name))]


def make() -> mujoco.MjModel:
    """The model with a converging solver, without the shortcuts that its compiler has prepared for it as it is: so each
    field may be changed by itself."""
    model = mujoco.MjModel.from_xml_string(XML)
    for shortcut in (model.body_sameframe, model.geom_sameframe, model.body_simple, model.dof_simplenum):
        shortcut[:] = 0
    model.geom_rbound[model.geom_rbound > 0], model.body_margin[:] = 1.0, 0.1
    model.body_contype[:] = model.body_conaffinity[:] = 255
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    model.opt.tolerance, model.opt.ls_tolerance = 0.0, 1e-12
    return model


def get(model: mujoco.MjModel, field: str) -> np.ndarray:
    """The values of a field, or of an option as `opt_timestep`."""
    part, _, name = field.partition("_")
    return np.asarray(getattr(getattr(model, part), name) if part in ("opt", "stat") else getattr(model, field))


def put(model: mujoco.MjModel, field: str, values: np.ndarray | float) -> None:
    """Other values of a field."""
    part, _, name = field.partition("_")
    if part not in ("opt", "stat"):
        getattr(model, field)[...] = values
    elif np.ndim(getattr(getattr(model, part), name)):
        getattr(getattr(model, part), name)[:] = values
    else:
        setattr(getattr(model, part), name, type(getattr(getattr(model, part), name))(values))


def changed(model: mujoco.MjModel, field: str, rng: np.random.Generator) -> np.ndarray:
    """Other values that the field may have: a tenth off, and above 0."""
    old = get(model, field)
    if old.dtype.kind != "f":
        return old + 1
    if field.endswith(("range", "impratio", "timestep")):
        return 1.1 * old
    new = old * (1.0 + 0.1 * rng.uniform(0.5, 1.0, old.shape)) + 0.004 * rng.uniform(0.5, 1.0, old.shape)
    if field.endswith(("quat", "axis")):
        new /= np.linalg.norm(new, axis=1, keepdims=True)
    return new


def worlds(count: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and torques of the motors' joints: on the ground, in the air, at limits, foot and ball in
    contact, at rest and moving; torques beyond the bounds of motors."""
    rng = np.random.default_rng(0)
    qpos = rng.uniform([-0.4, -0.3, -0.12], [0.4, 0.3, 0.1], (count, 3))
    calm = rng.choice([0.001, 1.0], (count, 1))
    return qpos, calm * rng.normal(size=(count, 3)), calm * rng.uniform(-8.0, 8.0, (count, 3))


def moved(model: mujoco.MjModel, steps: int = 3) -> np.ndarray:
    """Positions and velocities of `worlds` after a few time steps of native MuJoCo."""
    data, found = mujoco.MjData(model), []
    for qpos, qvel, torque in zip(*worlds(), strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = qpos, qvel
        data.ctrl = torque / (model.actuator_gainprm[:, 0] * model.actuator_gear[:, 0])
        mujoco.mj_step(model, data, steps)
        found.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(found)
