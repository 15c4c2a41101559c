"""Random numbers as a pure function of a key, so that batch size, order and process do not matter.

Each number is the SplitMix64 hash of (team key, tick, robot, channel). A team key is itself the hash of its seed and
episode.

Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

MASK = (1 << 64) - 1


def mix(x: int) -> int:
    """SplitMix64's finaliser on the host, for seeds."""
    x = (x + 0x9E3779B97F4A7C15) & MASK
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & MASK
    return x ^ (x >> 31)


def team_key(seed: int, episode: int) -> int:
    """64-bit key of one episode of the team with this seed."""
    return mix(mix(seed & MASK) ^ (episode & MASK))


@wp.func
def mix64(value: wp.uint64) -> wp.uint64:
    """SplitMix64's finaliser on the device, as `mix`."""
    x = value + wp.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> wp.uint64(30))) * wp.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> wp.uint64(27))) * wp.uint64(0x94D049BB133111EB)
    return x ^ (x >> wp.uint64(31))


@wp.func
def episode_key(seed: wp.uint64, episode: wp.uint64) -> wp.uint64:
    """`team_key` on the device."""
    return mix64(mix64(seed) ^ episode)


@wp.func
def draw_key(team: wp.uint64, tick: int, robot: int, channel: int) -> wp.uint64:
    """Key of one random number: 2^32 ticks, 2^16 robots, 2^16 channels."""
    place = (wp.uint64(tick) << wp.uint64(32)) | (wp.uint64(robot) << wp.uint64(16)) | wp.uint64(channel)
    return mix64(team ^ mix64(place))


@wp.func
def uniform(key: wp.uint64) -> float:
    """Uniform in (0, 1), both ends excluded: 23 bits and a half are exact in float32."""
    return (float(int(key >> wp.uint64(41))) + 0.5) / 8388608.0


@wp.func
def normal2(key: wp.uint64) -> wp.vec2:
    """Two independent standard normal numbers (Box-Muller)."""
    a = float(int((key >> wp.uint64(8)) & wp.uint64(0xFFFFFF))) * (6.283185307179586 / 16777216.0)
    r = wp.sqrt(-2.0 * wp.log(uniform(key)))
    return wp.vec2(r * wp.cos(a), r * wp.sin(a))


@wp.func
def normal3(team: wp.uint64, tick: int, robot: int, channel: int) -> wp.vec3:
    """Three independent standard normal numbers; uses this channel and the next."""
    a = normal2(draw_key(team, tick, robot, channel))
    b = normal2(draw_key(team, tick, robot, channel + 1))
    return wp.vec3(a[0], a[1], b[0])
