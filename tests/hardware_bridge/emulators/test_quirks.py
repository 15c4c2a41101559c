"""Wires on which things go wrong, and the clock of an emulated robot."""

from __future__ import annotations

import random
import subprocess
import sys

import pytest

from coop_envs.errors import ConfigError
from coop_envs.validation import validated
from hardware_bridge.emulators.quirks import FaultCommand, Quirks, Wire, damaged
from tests.hardware_bridge.fake_simulator import Emulator, FakeSimulator

PIECES = [bytes([k % 256]) * 10 for k in range(2000)]


def carried(quirks):
    wire = Wire(quirks, random.Random(quirks.seed))
    for k, piece in enumerate(PIECES):
        wire.put(piece, k * 0.01)
    return wire.take(1e9)


def test_a_good_wire_changes_nothing():
    assert carried(Quirks()) == PIECES


def test_shares_of_lost_and_garbled_pieces_are_as_set():
    got = carried(Quirks(lost=0.2, garbled=0.1))
    assert 0.17 < 1 - len(got) / len(PIECES) < 0.23
    assert 0.07 < sum(piece not in PIECES for piece in got) / len(got) < 0.13


def test_the_same_seed_gives_the_same_accidents():
    assert carried(Quirks(lost=0.1, garbled=0.3, seed=5)) == carried(Quirks(lost=0.1, garbled=0.3, seed=5))
    assert carried(Quirks(garbled=0.3, seed=5)) != carried(Quirks(garbled=0.3, seed=6))


def test_pieces_take_their_time_and_keep_their_order():
    wire = Wire(Quirks(delay_s=0.1, jitter_s=0.5), random.Random(0))
    for k in range(50):
        wire.put(bytes([k]), 0.001 * k)
    assert wire.take(0.09) == [] and wire.wait_s(0.05) is not None
    got = [piece for t in range(100) for piece in wire.take(0.01 * t)]
    assert got == [bytes([k]) for k in range(50)] and wire.wait_s(9.0) is None


def test_damage_changes_a_piece():
    chance = random.Random(1)
    assert all(damaged(b"abcdef", chance) != b"abcdef" for _ in range(200))


def test_the_robots_clock_drifts_and_wraps():
    quirks = Quirks(clock_start_us=2**32 - 1, clock_drift_ppm=100.0)
    assert quirks.device_us(0.0) == 2**32 - 1
    assert quirks.device_us(100.0) == 100_010_000 - 1
    assert quirks.device_us(1.0, jumped_s=-1.0001) == 2**32 - 1


@pytest.mark.parametrize(
    ("kind", "entry", "message"),
    [
        (Quirks, {"lost": 1.5}, "quirks.lost: got 1.5, expected a share from 0 to 1"),
        (Quirks, {"clock_start_us": -1}, "quirks.clock_start_us: got -1, expected 32 bits"),
        (Quirks, {"loss": 0.1}, "expected one of: lost"),
        (FaultCommand, {"fault": "freez"}, "did you mean 'freeze'"),
    ],
)
def test_entries_are_checked(kind, entry, message):
    with pytest.raises(ConfigError, match=message):
        validated(kind, entry)


def test_firmware_ends_at_a_signal_and_takes_its_port_along(tmp_path):
    path = tmp_path / "port"
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator, "--port-link", str(path)) as emulator:
        assert path.exists()
        emulator.process.terminate()
        assert emulator.process.wait(timeout=10) == 0 and not path.is_symlink()


def test_firmware_goes_on_after_a_fault_it_does_not_know():
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator) as emulator:
        emulator.fault("explode")
        emulator.fault("silent")
        assert emulator.process.poll() is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--simulator", "nowhere"], "--simulator: got 'nowhere', expected HOST:PORT"),
        (["--simulator", "127.0.0.1:1", "--quirks", "{"], "--quirks: got '{', expected JSON"),
        (["--simulator", "127.0.0.1:1"], "simulator 127.0.0.1:1: got no answer, expected a running simulator"),
    ],
)
def test_firmware_refuses_in_one_line(options, message):
    command = [sys.executable, "-m", "hardware_bridge.emulators.zumy_firmware", "--robot", "0", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr.strip()) == (2, message)
