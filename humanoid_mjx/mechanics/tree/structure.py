"""What is fixed about a tree of rigid bodies while its motion is compiled: topology, geometry, masses, contacts.

All of it is plain numbers in tuples, so that a `Tree` is hashable and zeros and ones fold away in `mechanics.scalars`.
Lengths in m, masses in kg, angles in rad. `reading.read_tree` makes it from a compiled MuJoCo model.
"""

from typing import NamedTuple

Triple = tuple[float, float, float]
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
    """The range of a hinge."""

    lower: float
    upper: float
    margin: float
    inverse_weight: float
    """1/(kg m^2): what MuJoCo takes for the inverse inertia that the limit feels."""
    softness: Softness


class Hinge(NamedTuple):
    """A joint with one axis."""

    name: str
    qpos: int
    """Where its angle stands in `qpos`; the bodies' poses in the model are those at `reference`."""
    dof: int
    axis: Triple
    anchor: Triple
    """Axis and a point on it in the frame of the body that the joint moves."""
    reference: float
    armature: float
    damping: float
    stiffness: float
    spring: float
    """N m/rad, and the angle at which the spring is slack."""
    limit: Limit | None


class Body(NamedTuple):
    """A rigid body."""

    name: str
    parent: int
    position: Triple
    """Of its origin in the frame of its parent, and where its axes point there, all joints at their reference."""
    axes: Axes
    mass: float
    center: Triple
    """Of mass, in its frame."""
    moments: Triple
    principal: Axes
    """Moments of inertia about the centre of mass, kg m^2, and the axes that they belong to, in its frame."""
    hinges: tuple[Hinge, ...]
    """Those between its parent and it, the parent's end first."""


class Surface(NamedTuple):
    """How two shapes feel each other."""

    friction: tuple[float, float] | None
    """Along the two tangents of the contact; None where there is none."""
    inverse_weight: float
    """1/kg: what MuJoCo takes for the inverse mass that the contact feels, both bodies together."""
    margin: float
    impratio: float
    softness: Softness


class Capsule(NamedTuple):
    """All points within `radius` of a segment; a ball where its half length is 0."""

    body: int
    center: Triple
    axis: Triple
    """A unit vector; both in the frame of the body."""
    radius: float
    half_length: float


class GroundPoint(NamedTuple):
    """A ball, or the end of a capsule, that a fixed plane pushes."""

    name: str
    body: int
    center: Triple
    radius: float
    normal: Triple
    height: float
    """Of the plane, along its normal in the world."""
    along: Triple | None
    """The first tangent follows this axis of the body (MuJoCo's capsules do); None: a fixed axis of the world."""
    surface: Surface


class Pair(NamedTuple):
    """Two capsules that push each other."""

    name: str
    one: Capsule
    two: Capsule
    surface: Surface


class Motor(NamedTuple):
    """What acts on a hinge: `clip(gain * clip(control) + bias[0] + bias[1] * length + bias[2] * speed)`, times gear."""

    name: str
    qpos: int
    dof: int
    gear: float
    gain: float
    bias: Triple
    control: tuple[float, float] | None
    force: tuple[float, float] | None


class Site(NamedTuple):
    """A place on a body that senses."""

    name: str
    body: int
    position: Triple
    axes: Axes
    """In the frame of the body."""
    box: bool
    """Whether its volume is a box rather than a ball."""
    size: Triple
    """Half the edges of the box; of a ball the first is the radius."""


class Tree(NamedTuple):
    """Rigid bodies joined by hinges; the first that moves may be free."""

    bodies: tuple[Body, ...]
    """The world is the first; parents come before their children."""
    free: int | None
    """The body that floats, whose six degrees of freedom are the first; None: everything hangs on the world."""
    nq: int
    nv: int
    ground: tuple[GroundPoint, ...]
    pairs: tuple[Pair, ...]
    motors: tuple[Motor, ...]
    gyroscopes: tuple[Site, ...]
    accelerometers: tuple[Site, ...]
    touch_sensors: tuple[Site, ...]
    gravity: Triple
    timestep: float
    implicit_damping: bool
    """Whether the joints' damping is taken at the end of a step, as MuJoCo's Euler does unless told otherwise."""

    @property
    def hinges(self) -> tuple[Hinge, ...]:
        """All of them, by degree of freedom."""
        return tuple(hinge for body in self.bodies for hinge in body.hinges)

    def path(self, body: int) -> tuple[int, ...]:
        """The bodies from the world's child to this one."""
        found: list[int] = []
        while body:
            found.append(body)
            body = self.bodies[body].parent
        return tuple(reversed(found))

    def dofs(self, body: int) -> tuple[int, ...]:
        """The degrees of freedom that move this body, in their order."""
        path = self.path(body)
        base = tuple(range(6)) if self.free in path else ()
        return base + tuple(hinge.dof for link in path for hinge in self.bodies[link].hinges)
