"""Body axes: the house has x forward, y left, z up; MAVLink has x forward, y right, z down."""

from __future__ import annotations

import math

from neuroflight.flash.link.messages import Attitude

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w x y z


def swap_frame(vector: Vector) -> Vector:
    """Convert a vector or rate between the two frames: half a turn about the common x."""
    x, y, z = vector
    return x, -y, -z


def euler_frd(attitude: Attitude) -> Vector:
    """Return roll right +, pitch nose up +, yaw right + within +-pi [rad], MAVLink's Euler angles."""
    yaw_deg = (attitude.heading_deg + 180.0) % 360.0 - 180.0
    return math.radians(attitude.roll_deg), math.radians(-attitude.pitch_deg), math.radians(yaw_deg)


def quaternion_frd(attitude: Attitude) -> Quaternion:
    """Return the attitude as a rotation of forward, right, down into north, east, down (w, x, y, z).

    Yaw is turned first, then pitch, then roll.
    """
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle / 2), math.sin(angle / 2)) for angle in euler_frd(attitude)
    )
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
