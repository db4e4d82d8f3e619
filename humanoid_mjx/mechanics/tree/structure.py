"""Structure of a tree of rigid bodies, fixed while its motion is compiled: topology, geometry, masses, contacts.

All of it is plain numbers in tuples, so that a `Tree` is hashable and zeros and ones fold away in kernels.
Lengths in m, masses in kg, angles in rad. `reading.read_tree` makes it from a compiled MuJoCo model.

Limbs of one build, as the legs of a body, are *lanes*: `folding.fold` makes them one branch, whose numbers are a table
of the lanes' where they differ. What is computed of a branch then has an axis of lanes before that of the worlds.
"""

from typing import Any, Literal, NamedTuple


class Table(NamedTuple):
    """Numbers where one would stand: of alike limbs, or of alike contacts of one body."""

    shape: tuple[int, ...]
    values: tuple[float, ...]


Number = float | Table
Triple = tuple[Number, Number, Number]
Axes = tuple[Triple, Triple, Triple]
"""The axes of one frame in another: its columns as a rotation matrix."""


FRICTIONLESS = 1e-5
"""MuJoCo's smallest coefficient of friction (mjMINMU)."""


class Softness(NamedTuple):
    """A soft constraint: how a violation is answered (MuJoCo's `solref`), and how stiffly (`solimp`).

    The constraint's reference acceleration is `-damping * velocity - stiffness * impedance * violation`.
    """

    stiffness: float
    """1/s^2"""
    damping: float
    """1/s"""
    dmin: float
    dmax: float
    width: float
    midpoint: float
    power: float


class Limit(NamedTuple):
    """The range of a joint."""

    lower: Number
    upper: Number
    margin: Number
    inverse_weight: Number
    """1/(kg m^2): what MuJoCo takes for the inverse inertia that the limit feels."""
    softness: Softness


class Dry(NamedTuple):
    """Dry friction of a joint."""

    most: Number
    """N m"""
    inverse_weight: Number
    """1/(kg m^2)"""
    softness: Softness


class Drag(NamedTuple):
    """Resistance to the motion of a free body: alike along and about all axes."""

    armature: float
    damping: float
    """N s/m, N m s/rad"""
    dry: tuple[Dry, ...]
    """Along an axis and about one; none without dry friction."""


class Joint(NamedTuple):
    """A joint with one axis."""

    coordinate: int
    """Index of its angle or way among the coordinates; the bodies' poses in the model are those at `reference`."""
    dof: int
    slides: bool
    """True if it moves along its axis, so m and N stand where a hinge has rad and N m."""
    axis: Triple
    anchor: Triple
    """Axis and a point on it in the frame of the body that the joint moves."""
    reference: Number
    armature: Number
    damping: Number
    stiffness: Number
    spring: Number
    """N m/rad, and the angle at which the spring is slack."""
    limit: Limit | None
    dry: Dry | None


class Body(NamedTuple):
    """A rigid body, or one of each lane."""

    parent: int
    position: Triple
    """Position of its origin in the frame of its parent, m, and below where its axes point there, all joints at their
    reference."""
    axes: Axes
    mass: Number
    center: Triple
    """Centre of mass in its frame, m."""
    moment: Number
    extra: tuple[tuple[Number, Triple], ...]
    """The moment of inertia about the centre of mass across all of these principal axes, in its frame, and by how much
    more it is about each, kg m^2. Bodies of revolution have one, balls none."""
    joints: tuple[Joint, ...]
    """Those between its parent and it, the parent's end first."""
    laned: bool = False


class Surface(NamedTuple):
    """Parameters of the contact of two shapes."""

    friction: tuple[Number, Number] | None
    """Along the two tangents of the contact; None where there is none."""
    inverse_weight: Number
    """1/kg: what MuJoCo takes for the inverse mass that the contact feels, both bodies together."""
    margin: float
    impratio: float
    softness: Softness
    elliptic: bool = False
    """True if the cone of friction is elliptic, else it is a pyramid."""


class Capsule(NamedTuple):
    """All points within `radius` of a segment; a ball where its half length is 0."""

    body: int
    center: Triple
    axis: Triple
    """A unit vector; both in the frame of the body."""
    radius: float
    half_length: float
    lane: int = 0


class Box(NamedTuple):
    """A box that other shapes push."""

    body: int
    center: Triple
    axes: Axes
    """In the frame of the body."""
    half: Triple
    """Half of its edges, m."""
    lane: int = 0


class Corner(NamedTuple):
    """The lower end of a diagonal of a box; the plane pushes the lower ends of all four."""

    half: Triple
    """From the middle of the box to one end."""


class Rim(NamedTuple):
    """A point on a rim of a cylinder: the lowest of all, its like on the other end, or one of two on the sides of the
    lower rim."""

    which: Literal["lowest", "opposite", "left", "right"]
    axis: Triple
    side: Triple
    """An axis of the disk, that stands for the lowest direction where the disk is level."""
    half_length: Number
    radius: Number


class Lowest(NamedTuple):
    """The lowest point of an ellipsoid."""

    axes: Axes
    radii: Triple


class GroundPoints(NamedTuple):
    """Balls, ends of capsules, or points of other shapes of one body that a fixed plane pushes."""

    body: int
    center: Triple
    radius: Number
    normal: Triple
    height: Number
    """Height of the plane along its normal in the world, m."""
    along: Triple | None
    """The first tangent follows this axis of the body (MuJoCo's capsules do); None: a fixed axis of the world."""
    surface: Surface
    order: tuple[int, ...]
    """Indices of the model's points; point by point, lane by lane."""
    shape: Corner | Rim | Lowest | None = None
    """Offset of the point from `center` that follows the posture, if any."""
    upper: bool = False
    """True if the upper of the two steps nearest to the point pushes it, on a ground with stairs."""


class Pairs(NamedTuple):
    """Shapes that push each other, contact by contact: two boxes stand here `boxes.CONTACTS` times, a capsule and a
    box `boxes.PLACES` times, the box second."""

    ones: tuple[Any, ...]
    twos: tuple[Any, ...]
    surface: Surface


class Site(NamedTuple):
    """A place on a body that senses."""

    body: int
    position: Triple
    axes: Axes
    """In the frame of the body."""
    lane: int = 0


Integrator = Literal["explicit", "damped", "RK4"]
"""Semi-implicit Euler with the joints' damping taken at the beginning of a step or at its end, as MuJoCo's Euler does
unless told otherwise, and `implicitfast`; Runge and Kutta's of order 4."""


class Tree(NamedTuple):
    """Rigid bodies joined by hinges and slides; the first that moves may be free."""

    bodies: tuple[Body, ...]
    """The world is the first; parents come before their children."""
    free: int | None
    """The body that floats, whose six degrees of freedom are the first; None: everything hangs on the world."""
    drag: Drag | None
    """Resistance to its motion; None without any."""
    coordinates: tuple[tuple[int, ...], ...]
    dofs: tuple[tuple[int, ...], ...]
    """Index of each coordinate in `qpos` and of each degree of freedom in `qvel`: one, or one for each lane."""
    lanes: int
    body_places: tuple[tuple[int, ...], ...]
    """Index of each body among the model's: one, or one for each lane."""
    ground: tuple[GroundPoints, ...]
    feet: tuple[tuple[int, ...], ...]
    """Indices of the model's points of each shape that sensors report."""
    pairs: tuple[Pairs, ...]
    motors: tuple[int, ...]
    """Places in `qvel` of the joints that motors drive."""
    gyroscopes: tuple[Site, ...]
    accelerometers: tuple[Site, ...]
    gravity: tuple[float, float, float]
    timestep: float
    integrator: Integrator

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All of them, by degree of freedom."""
        return tuple(joint for body in self.bodies for joint in body.joints)

    @property
    def nv(self) -> int:
        """Degrees of freedom, those of all lanes counted once."""
        return len(self.dofs)

    def own(self, body: int) -> tuple[int, ...]:
        """The degrees of freedom between a body and its parent."""
        return tuple(range(6)) if body == self.free else tuple(joint.dof for joint in self.bodies[body].joints)

    def moving(self, body: int) -> tuple[int, ...]:
        """The degrees of freedom that move a body, in their order."""
        found: tuple[int, ...] = ()
        while body:
            found, body = self.own(body) + found, self.bodies[body].parent
        return found

    def above(self, dof: int) -> tuple[int, ...]:
        """The degrees of freedom that move all that this one moves, itself the last."""
        moving = next(self.moving(body) for body in range(len(self.bodies)) if dof in self.own(body))
        return moving[: moving.index(dof) + 1]

    def laned(self, dof: int) -> bool:
        """True if there is one of each lane."""
        return len(self.dofs[dof]) > 1
