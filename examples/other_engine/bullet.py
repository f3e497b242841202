"""The gripper, the box and the table in PyBullet, read in candata's conventions."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bodies
import numpy as np
import pybullet
from numpy.typing import NDArray
from pybullet_utils.bullet_client import BulletClient

from candata.rotation import conjugate, normalise, rotate

Array = NDArray[np.float64]
#: Physics steps a row. The servos are explicit here and implicit in MuJoCo: at 24 and 10 steps a row the joints of a
#: free motion differ by 0.5 mrad rms, half of the encoders' noise, and by less the finer the steps.
SUBSTEPS = 24


@dataclass(frozen=True)
class Hidden:
    """What the world does that the nominal scene does not know; the identity by default."""

    mass_scale: float = 1.0
    friction_scale: float = 1.0
    damping_nms_rad: float = 0.0


class World:
    """One simulation."""

    def __init__(self, hidden: Hidden) -> None:
        self.client = BulletClient(connection_mode=pybullet.DIRECT)
        self.client.setGravity(0, 0, -9.81)
        self.client.setPhysicsEngineParameter(fixedTimeStep=1 / bodies.RATE_HZ / SUBSTEPS, numSolverIterations=100)
        self.hand = _load_hand(self.client, hidden.damping_nms_rad)
        self.box = _add_box(self.client, bodies.BOX_MASS_KG * hidden.mass_scale)
        self.table = self.client.createMultiBody(0, self.client.createCollisionShape(pybullet.GEOM_PLANE))
        joints = range(self.client.getNumJoints(self.hand))
        self.index = {self.client.getJointInfo(self.hand, j)[1].decode(): j for j in joints}
        self.joints = [self.index[link.name] for link in bodies.LINKS]
        self.tips = [self.index[name] for name in bodies.TIPS]
        self._servos = np.array([(link.kp, link.kv, link.limit) for link in bodies.LINKS]).T
        self._contacts(hidden.friction_scale)

    def _contacts(self, scale: float) -> None:
        """Set friction and which bodies meet; switch off every drag and motor that Bullet adds by itself."""
        client = self.client
        # Bullet multiplies the friction of a pair: the box has 1, or less where friction is hidden.
        plain = {"restitution": 0, "linearDamping": 0, "angularDamping": 0, "rollingFriction": 0, "spinningFriction": 0}
        client.changeDynamics(self.table, -1, lateralFriction=bodies.TABLE_FRICTION, **plain)
        awake = pybullet.ACTIVATION_STATE_DISABLE_SLEEPING
        client.changeDynamics(self.box, -1, lateralFriction=scale, activationState=awake, **plain)
        for j in range(-1, client.getNumJoints(self.hand)):
            client.changeDynamics(self.hand, j, lateralFriction=bodies.TIP_FRICTION, **plain)
            client.setCollisionFilterPair(self.hand, self.table, j, -1, 0)
        client.setJointMotorControlArray(
            self.hand, self.joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(self.joints)
        )

    def place(self, joints: Array, pose: Array) -> None:
        """Put the joints `(J,)` and the box `(7,)` w x y z somewhere, at rest."""
        for j, q in zip(self.joints, joints, strict=True):
            self.client.resetJointState(self.hand, j, float(q), 0.0)
        w, x, y, z = pose[3:]
        self.client.resetBasePositionAndOrientation(self.box, pose[:3].tolist(), [x, y, z, w])

    def read(self) -> tuple[Array, Array]:
        """Return the joints `(J,)` and the box's pose `(7,)`, position and quaternion w x y z."""
        joints = np.array([s[0] for s in self.client.getJointStates(self.hand, self.joints)])
        position, (x, y, z, w) = self.client.getBasePositionAndOrientation(self.box)
        return joints, np.concatenate([position, normalise(np.array([w, x, y, z]))])

    def step(self, command: Array) -> Array:
        """Advance one row under a held command `(A,)`; return the mean force of the box on each fingertip `(F, 3)`."""
        force = np.zeros((len(self.tips), 3))
        kp, kv, limit = self._servos
        for _ in range(SUBSTEPS):
            states = self.client.getJointStates(self.hand, self.joints)
            q, speed = np.array([s[:2] for s in states]).T
            torque = np.clip(kp * (command - q) - kv * speed, -limit, limit)
            self.client.setJointMotorControlArray(
                self.hand, self.joints, pybullet.TORQUE_CONTROL, forces=torque.tolist()
            )
            # Readings are at the start of a step, as MuJoCo's sensors are: frames before the step, forces of it.
            frames = [link_rotation(self.client, self.hand, tip) for tip in self.tips]
            self.client.stepSimulation()
            world = np.array([force_on(self.client, self.hand, tip, self.box) for tip in self.tips])
            force += rotate(conjugate(np.array(frames)), world)
        return force / SUBSTEPS

    def close(self) -> None:
        """End the simulation."""
        self.client.disconnect()


def force_on(client: BulletClient, body: int, link: int, other: int) -> Array:
    """Return the force `(3,)` that `other` exerts on a link, in the world's frame [N].

    Bullet's contact normal lies on `other` and points to the link: the direction in which the link is pushed. The two
    friction forces are those on the link too.
    """
    total = np.zeros(3)
    for c in client.getContactPoints(bodyA=body, bodyB=other, linkIndexA=link):
        for size, direction in ((c[9], c[7]), (c[10], c[11]), (c[12], c[13])):
            total += size * np.array(direction)
    return total


def link_rotation(client: BulletClient, body: int, link: int) -> Array:
    """Return the rotation `(4,)` w x y z of a link's own frame (its joint's, not its inertia's)."""
    x, y, z, w = client.getLinkState(body, link, computeForwardKinematics=1)[5]
    return np.array([w, x, y, z])


def _load_hand(client: BulletClient, damping: float) -> int:
    """Return the gripper, read from its URDF."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gripper.urdf"
        path.write_text(bodies.urdf(damping))
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        return int(client.loadURDF(str(path), bodies.PALM_M, useFixedBase=True, flags=flags))


def _add_box(client: BulletClient, mass: float) -> int:
    """Return the box."""
    shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=bodies.BOX_HALF_M)
    box = int(client.createMultiBody(mass, shape, basePosition=(0, 0, bodies.BOX_HALF_M[2])))
    client.changeDynamics(box, -1, localInertiaDiagonal=bodies.box_inertia(mass))
    return box
