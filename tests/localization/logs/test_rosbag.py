from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import Fix, ImuSample, Log, Odometry, PoseSighting
from coop_envs.localization.logs.read_log import read_log
from tests.localization.logs import bags
from tests.localization.logs.small_logs import log_or_refusal, random_covariance

TEAM = {"base": "inchworm", "names": {"observer_0": "zumy1", "picket_0": "zumy2", "picket_1": "zumy3"}}
T0 = 1_500_000_000.0
ROS_ORDER = [3, 4, 5, 0, 1, 2]


def stream(count: int = 100, robot: str = "zumy1") -> list[bags.Message]:
    """Samples of one IMU at 100 Hz, recorded 4 ms later; the turn about x counts them."""
    return [
        (f"/{robot}/imu", T0 + 0.01 * k + 0.004, bags.imu(T0 + 0.01 * k, gyro=(k, 0.0, 0.1), accel=(1, 2, 9.81)))
        for k in range(count)
    ]


def of_type(log: Log, kind: type) -> list:
    return [event for event in log.events if isinstance(event, kind)]


@pytest.mark.parametrize("compression", [None, "bz2", "lz4"])
def test_every_kind_of_message(tmp_path, compression):
    rng = np.random.default_rng(0)
    P, turn = random_covariance(rng), Rotation.random(None, rng)
    at = bags.pose((1.0, 2.0, 3.0), turn.as_quat()[[3, 0, 1, 2]])
    in_ros = P[np.ix_(ROS_ORDER, ROS_ORDER)]
    path = bags.write_bag(
        tmp_path / "run.bag",
        [
            *stream(),
            ("/zumy1/odom", T0, bags.odometry(T0, 0.2, -0.3)),
            ("/zumy2/odom", T0, bags.twist_stamped(T0 - 0.5, 0.1, 0.4)),
            ("/zumy1/poses/zumy2", T0 + 0.1, bags.pose_with_covariance(T0 + 0.05, at, in_ros)),
            ("/zumy3/fix", T0 + 0.2, bags.pose_with_covariance(T0 + 0.15, at, in_ros)),
            ("/zumy1/truth", T0 + 0.2, bags.pose_stamped(T0 + 0.2, at)),
            ("/zumy1/truth", T0 + 0.3, bags.pose_stamped(T0 + 0.1, at)),
            ("/camera/image", T0, bags.twist_stamped(T0, 0.0, 0.0)),
        ],
        compression,
    )
    log = read_log(path, TEAM)
    assert log.notes == ("run.bag: topics not read: /camera/image",)
    assert log.robots == ("zumy1", "zumy2", "zumy3") and log.team is not None
    samples = of_type(log, ImuSample)
    assert [sample.gyro[0] for sample in samples] == list(range(100))
    assert samples[7].time_s == pytest.approx(T0 + 0.07, abs=1e-6)
    assert samples[7].arrival_s == pytest.approx(T0 + 0.074, abs=1e-6)
    assert np.array_equal(samples[7].accel, [1.0, 2.0, 9.81])
    assert {(o.robot, o.forward_m_s, o.yaw_rate_rad_s, o.time_s - T0) for o in of_type(log, Odometry)} == {
        ("zumy1", 0.2, -0.3, 0.0),
        ("zumy2", 0.1, 0.4, -0.5),
    }
    (sighting,), (fix,) = of_type(log, PoseSighting), of_type(log, Fix)
    assert (sighting.camera, sighting.robot, fix.robot) == ("zumy1", "zumy2", "zumy3")
    for event in (sighting, fix):
        assert np.allclose(event.rotation, turn.as_matrix(), atol=1e-12)
        assert np.array_equal(event.position, [1.0, 2.0, 3.0])
        assert np.array_equal(event.covariance, P)
    assert np.allclose(log.truth["zumy1"].time_s, [T0 + 0.1, T0 + 0.2])


def test_topics_of_ones_own(tmp_path):
    at = bags.pose((1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    path = bags.write_bag(
        tmp_path / "run.bag",
        [
            ("/robots/zumy2/sensors/imu", T0, bags.imu(T0)),
            ("/wheels", T0, bags.twist_stamped(T0, 0.2, 0.1)),
            ("/cam0/sees/zumy2", T0, bags.pose_stamped(T0, at)),
            ("/vicon/zumy2/zumy2", T0, bags.pose_stamped(T0, at)),
            ("/vicon/zumy2/zumy1", T0, bags.pose_stamped(T0, at)),
        ],
    )
    topics = {
        "imu": ["/robots/{robot}/sensors/imu"],
        "odometry": {"topic": "/wheels", "robot": "zumy1"},
        "poses": {
            "topic": "/cam0/sees/{robot}",
            "camera": "zumy1",
            "sigma_rotation_rad": 0.02,
            "sigma_position_m": 0.01,
        },
        "truth": "/vicon/{robot}/{robot}",
    }
    log = read_log(path, {**TEAM, "topics": topics})
    assert log.notes == ("run.bag: topics not read: /vicon/zumy2/zumy1",)
    (sighting,) = of_type(log, PoseSighting)
    assert np.allclose(np.diag(sighting.covariance), [4e-4] * 3 + [1e-4] * 3)
    assert (sighting.camera, of_type(log, Odometry)[0].robot, list(log.truth)) == ("zumy1", "zumy1", ["zumy2"])


@pytest.mark.parametrize(
    ("topics", "message"),
    [
        ({"imus": "/{robot}/imu"}, r"topics: got 'imus', expected a kind of row: .*did you mean 'imu'\?"),
        ({"imu": "/imu"}, r"topics.imu: got '/imu', expected a topic with \{robot\}, or an entry robot"),
        ({"imu": "/{robot}/{camera}"}, "topics.imu: got '/{robot}/{camera}', expected none for a camera"),
        (
            {"poses": "/{robot}"},
            r"topics.poses: got '/\{robot\}', expected a topic with \{camera\}, or an entry camera",
        ),
        ({"imu": {"topic": "/x", "robots": "a"}}, "topics.imu.robots: got 'robots'"),
        ({"poses": {"topic": "/{camera}/{robot}", "sigma_position_m": 0}}, "topics.sigma_position_m: got 0"),
        ({"imu": 3}, "topics.imu: got 3"),
    ],
)
def test_topics_refused(tmp_path, topics, message):
    path = bags.write_bag(tmp_path / "run.bag", stream(1))
    with pytest.raises(ConfigError, match=message):
        read_log(path, {**TEAM, "topics": topics})


def test_messages_that_lack_something(tmp_path):
    at = bags.pose((1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    bare = ("/zumy1/poses/zumy2", T0, bags.pose_stamped(T0, at))
    with pytest.raises(
        ConfigError, match=r"run.bag message 1 on /zumy1/poses/zumy2, covariance: got None, expected one"
    ):
        read_log(bags.write_bag(tmp_path / "run.bag", [*stream(), bare]), TEAM)
    zeros = ("/zumy1/poses/zumy2", T0, bags.pose_with_covariance(T0, at, np.zeros((6, 6))))
    with pytest.raises(ConfigError, match=r"or an entry topics.poses.sigma_rotation_rad that stands for it"):
        read_log(bags.write_bag(tmp_path / "run.bag", [*stream(), zeros]), TEAM)
    lone = bags.write_bag(tmp_path / "run.bag", [*stream(), ("/zumy1/odom", T0, bags.twist(0.1, 0.0))])
    note = "run.bag: messages on /zumy1/odom without a stamp: 1, taken as measured when recorded"
    assert read_log(lone, TEAM).notes == (note,)
    assert of_type(read_log(lone, TEAM), Odometry)[0].time_s == T0
    wrong = bags.write_bag(tmp_path / "run.bag", [*stream(), ("/zumy2/imu", T0, bags.pose_stamped(T0, at))])
    (note,) = read_log(wrong, TEAM).notes
    assert note == "run.bag: /zumy2/imu: geometry_msgs/PoseStamped is not read as imu, sensor_msgs/Imu are"


def test_refused_with_message_and_field(tmp_path):
    at = bags.pose((1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    skew, negative, infinite = np.eye(6), -np.eye(6), np.eye(6)
    skew[0, 1], infinite[2, 2] = 0.5, np.nan
    for P, expected in ((skew, "a symmetric matrix"), (negative, "a positive definite"), (infinite, "finite numbers")):
        sighting = ("/zumy1/poses/zumy2", T0, bags.pose_with_covariance(T0, at, P))
        path = bags.write_bag(tmp_path / "run.bag", [*stream(), sighting])
        place = "run.bag message 1 on /zumy1/poses/zumy2, covariance: got"
        with pytest.raises(ConfigError, match=f"{place} .* expected {expected}"):
            read_log(path, TEAM)
    path = bags.write_bag(tmp_path / "run.bag", [*stream(3), ("/zumy1/imu", T0 + 1, bags.imu(T0 + 1, (0, np.nan, 0)))])
    with pytest.raises(ConfigError, match=r"run.bag message 4 on /zumy1/imu, gyro_y_rad_s: got nan, expected a finite"):
        read_log(path, TEAM)
    with pytest.raises(
        ConfigError, match=r"run.bag message 1 on /zumy9/imu, robot: got 'zumy9', expected a robot: zumy1"
    ):
        read_log(bags.write_bag(tmp_path / "run.bag", stream(3, "zumy9")), TEAM)
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(ConfigError, match=r"expected a ROS bag of version 2\.0"):
        read_log(tmp_path / "old.bag")


def test_messages_of_another_definition_are_refused(tmp_path):
    path = bags.write_bag(tmp_path / "run.bag", stream(3))
    checksum = bags.STORE.generate_msgdef("sensor_msgs/msg/Imu", ros_version=1)[1].encode()
    path.write_bytes(path.read_bytes().replace(checksum, b"0" * 32))
    with pytest.raises(ConfigError, match=r"run.bag message 1 on /zumy1/imu, md5sum: got '0{32}', expected 6a62c6da"):
        read_log(path, TEAM)


@pytest.mark.parametrize("compression", [None, "bz2", "lz4"])
def test_a_truncated_bag_gives_what_it_holds_and_says_so(tmp_path, compression):
    path = bags.write_bag(tmp_path / "run.bag", stream(400), compression, chunk_bytes=4_000)
    whole = path.read_bytes()
    assert len(read_log(path, TEAM).events) == 400
    counts = []
    for share in (0.3, 0.4, 0.5, 0.6, 0.7):
        path.write_bytes(whole[: int(share * len(whole))])
        log = read_log(path, TEAM)
        counts.append(len(log.events))
        assert log.notes == ("run.bag was cut short: read up to there",)
        assert [event.gyro[0] for event in log.events] == list(range(len(log.events)))  # type: ignore[union-attr]
    assert counts[0] > 0 and counts == sorted(set(counts))


def test_a_cut_inside_a_chunk_keeps_the_messages_before_it(tmp_path):
    path = bags.write_bag(tmp_path / "run.bag", stream(400), chunk_bytes=1 << 20)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.5 * len(whole))])
    assert 150 < len(read_log(path, TEAM).events) < 250
    path.write_bytes(whole[:4200])
    with pytest.raises(ConfigError, match=r"run.bag: got 'no rows; run.bag was cut short: read up to there', expected"):
        read_log(path, TEAM)


def test_a_bag_without_index_is_read_and_noted(tmp_path):
    path = bags.write_bag(tmp_path / "run.bag", stream(50))
    content = bytearray(path.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    content[at : at + 8] = bytes(8)
    path.write_bytes(content)
    log = read_log(path, TEAM)
    assert len(log.events) == 50
    assert log.notes == ("run.bag has no index, its recorder was not ended properly: read from front to back",)


def test_a_damaged_chunk_costs_no_more_than_itself(tmp_path):
    path = bags.write_bag(tmp_path / "run.bag", stream(400), "bz2", chunk_bytes=20_000)
    content = bytearray(path.read_bytes())
    second = content.index(b"BZh", content.index(b"BZh") + 1)
    content[second + 200] ^= 0xFF
    path.write_bytes(content)
    log = read_log(path, TEAM)
    found = [int(event.gyro[0]) for event in log.events]  # type: ignore[union-attr]
    assert found[0] == 0 and found[-1] == 399 and 300 < len(found) < 400
    assert log.notes == ("run.bag has a part that cannot be decompressed: read up to there",)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_gives_a_log_or_a_plain_refusal(tmp_path, data):
    path = tmp_path / "run.bag"
    compression = data.draw(st.sampled_from([None, "bz2", "lz4"]))
    content = bytearray(bags.write_bag(path, stream(40), compression, chunk_bytes=2000).read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(13, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(13, len(content)))])
    assert log_or_refusal(path, TEAM)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300))
def test_any_bytes_give_a_plain_refusal(tmp_path, content):
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n" + content)
    assert isinstance(log_or_refusal(tmp_path / "run.bag", TEAM), str)


def write_with_ros(path: Path, compression: str) -> None:
    """Samples of an IMU and one pose, written by ROS's own library."""
    from hardware_bridge.ros1 import import_rospy, message

    rospy = import_rospy()
    rosbag = importlib.import_module("rosbag")
    Imu, Pose = message("sensor_msgs/Imu"), message("geometry_msgs/PoseWithCovarianceStamped")
    bag = rosbag.Bag(str(path), "w", compression=compression, chunk_threshold=5000)
    for k in range(100):
        sample = Imu()
        sample.header.stamp = rospy.Time.from_sec(100.0 + 0.01 * k)
        sample.angular_velocity.x, sample.linear_acceleration.z = float(k), 9.81
        bag.write("/zumy1/imu", sample, rospy.Time.from_sec(100.004 + 0.01 * k))
    sighting = Pose()
    sighting.header.stamp = rospy.Time.from_sec(100.5)
    sighting.pose.pose.position.x, sighting.pose.pose.orientation.w = 1.5, 1.0
    sighting.pose.covariance = np.diag([1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4]).ravel().tolist()
    bag.write("/zumy1/poses/zumy2", sighting, rospy.Time.from_sec(100.51))
    bag.close()


@pytest.mark.ros
@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_bags_of_ros_itself(tmp_path, compression):
    write_with_ros(tmp_path / "run.bag", compression)
    log = read_log(tmp_path / "run.bag", TEAM)
    assert log.notes == () and len(log.events) == 101
    samples = of_type(log, ImuSample)
    assert [sample.gyro[0] for sample in samples] == list(range(100))
    assert samples[3].time_s == pytest.approx(100.03) and samples[3].arrival_s == pytest.approx(100.034)
    (sighting,) = of_type(log, PoseSighting)
    assert np.allclose(np.diag(sighting.covariance), [4e-4, 5e-4, 6e-4, 1e-4, 2e-4, 3e-4])
    whole = (tmp_path / "run.bag").read_bytes()
    (tmp_path / "run.bag").write_bytes(whole[: len(whole) // 2])
    assert 0 < len(read_log(tmp_path / "run.bag", TEAM).events) < 100
