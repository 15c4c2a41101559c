"""ROS 1 in this process: rospy found and imported, one node for one master, services whose reply nobody published.

rospy keeps one node a process and one master a node, for as long as the process lives. The node takes no signals, no
logging handlers and no simulated time from ROS, and is gone when the main thread ends.
"""

from __future__ import annotations

import http.client
import importlib
import importlib.util
import logging
import os
import shutil
import socket
import sys
import tempfile
import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from coop_envs.errors import require
from hardware_bridge.link import LinkError

DEBIAN = Path("/usr/lib/python3/dist-packages")
PACKAGES = "python3-rospy python3-geometry-msgs python3-sensor-msgs python3-std-msgs (apt install)"
MASTER_TIMEOUT_S = 2.0
WRITING_S = 0.02
LOGGERS = ("rospy", "rosgraph", "rosout")

_lock = threading.Lock()
_masters: list[str] = []


def missing() -> str | None:
    """What keeps ROS 1 from running here, in one line; None where nothing does."""
    if importlib.util.find_spec("rospy") is None and not _debian_fits():
        return f"rospy: got none for this Python, expected {PACKAGES} and the Python they are for"
    if shutil.which("roscore") is None:
        return "roscore: got no such command, expected python3-roslaunch (apt install)"
    return None


def import_rospy() -> Any:
    """rospy, from wherever it is. Debian's folder comes last in the path, so it shadows nothing.

    Raises:
        LinkError: this Python has none.
    """
    with _lock:
        if importlib.util.find_spec("rospy") is None and _debian_fits():
            sys.path.append(str(DEBIAN))
        try:
            rospy = importlib.import_module("rospy")
            for messages in ("geometry_msgs", "sensor_msgs", "std_msgs"):
                importlib.import_module(f"{messages}.msg")
        except ImportError as error:
            raise LinkError(f"rospy: got {error}, expected {PACKAGES} and the Python they are for") from None
    return rospy


def message(kind: str) -> Any:
    """The class of a message such as ``std_msgs/Int32``; `import_rospy` comes first."""
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def service_class(kind: str, request: str, response: str = "", *, strict: bool = False) -> Any:
    """A service that no installed package describes, from the text of its two messages.

    Unless it is ``strict``, its checksum matches every service, and what a reply holds beyond ``response`` is dropped:
    one can call a service of which only the request is known.
    """
    dynamic, genmsg = importlib.import_module("genpy.dynamic"), importlib.import_module("genmsg")
    messages = [
        dynamic.generate_dynamic(kind + part, text)[kind + part]
        for part, text in (("Request", request), ("Response", response))
    ]
    context = genmsg.msg_loader.MsgContext.create_default()
    checksum = "*"
    if strict:
        spec = genmsg.msg_loader.load_srv_from_string(context, f"{request}\n---\n{response}", kind)
        checksum = genmsg.compute_md5(context, spec)
    members = {"_type": kind, "_md5sum": checksum, "_request_class": messages[0], "_response_class": messages[1]}
    return type(kind.split("/")[1], (), members)


def connected(end: Any) -> bool:
    """Whether a publisher or subscriber has a connection that stands; rospy also counts those it tries to renew."""
    return any(connection.socket is not None for connection in list(end.impl.connections))


def flush(publisher: Any, timeout_s: float) -> None:
    """Wait until what a publisher has queued is on its way: rospy loses it when the publisher leaves."""
    end = time.monotonic() + timeout_s
    while any(connection._queue for connection in list(publisher.impl.connections)) and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(WRITING_S)


def require_master(field: str, uri: str) -> None:
    """Raise `ConfigError` unless this is a master's address, http://HOST:PORT."""
    parts = urlsplit(uri)
    try:
        fits = parts.scheme == "http" and bool(parts.hostname) and bool(parts.port) and parts.path in ("", "/")
    except ValueError:
        fits = False
    require(fits, field, uri, "the address of a ROS master, http://HOST:11311")


def require_name(field: str, name: str) -> None:
    """Raise `ConfigError` unless this is an absolute name in ROS's graph, as /zumy1."""
    parts = name.split("/")
    legal = parts[0] == "" and len(parts) > 1 and all(p.isidentifier() and p.isascii() for p in parts[1:])
    require(legal, field, name, "an absolute ROS name, as /zumy1")


def ask_master(uri: str, timeout_s: float = MASTER_TIMEOUT_S) -> None:
    """See that a master answers.

    Raises:
        LinkError: none does, in time.
    """
    proxy: Any = xmlrpc.client.ServerProxy(uri, transport=_Patient(timeout_s))
    try:
        proxy.getPid("/coop_bridge")
    except (OSError, http.client.HTTPException, xmlrpc.client.Error) as error:
        reason = str(error) or type(error).__name__
        raise LinkError(f"master {uri}: got no answer ({reason}), expected a running roscore") from None


def start_node(name: str, master: str) -> Any:
    """rospy, with this process's node registered at a master; a second call for the same master changes nothing.

    Raises:
        LinkError: no rospy, no master, or the process already speaks to another master.
    """
    rospy = import_rospy()
    ask_master(master)
    with _lock:
        if _masters and _masters != [master]:
            raise LinkError(f"master: got {master}, expected {_masters[0]}: rospy knows one master a process")
        if not _masters:
            _register(rospy, name, master)
            _masters.append(master)
            threading.Thread(target=_leave_with_main_thread, args=(rospy,), daemon=True).start()
    return rospy


class _Patient(xmlrpc.client.Transport):
    """HTTP that gives up after a while."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__()
        self._timeout_s = timeout_s

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        """The connection, with its timeout."""
        connection = super().make_connection(host)
        connection.timeout = self._timeout_s
        return connection


def _debian_fits() -> bool:
    """Whether Debian's packages are there and its Python is of this interpreter's version."""
    version = "python{}.{}".format(*sys.version_info[:2])
    return (DEBIAN / "rospy").is_dir() and Path("/usr/bin/python3").resolve().name == version


def _register(rospy: Any, name: str, master: str) -> None:
    os.environ["ROS_MASTER_URI"] = master
    if not {"ROS_IP", "ROS_HOSTNAME"} & os.environ.keys():
        os.environ["ROS_IP"] = _own_address(master)
    for logger in LOGGERS:
        logging.getLogger(logger).setLevel(logging.CRITICAL)
    before = os.environ.get("ROS_PYTHON_LOG_CONFIG_FILE")
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as config:
        config.write("version: 1\nincremental: true\n")  # else rospy puts its own handlers in place of the program's
        config.flush()
        os.environ["ROS_PYTHON_LOG_CONFIG_FILE"] = config.name
        try:
            rospy.init_node(
                name, argv=[name], anonymous=True, disable_signals=True, disable_rosout=True, disable_rostime=True
            )
        except rospy.exceptions.ROSException as error:
            raise LinkError(f"master {master}: got {error}, expected to register a node") from None
        finally:
            del os.environ["ROS_PYTHON_LOG_CONFIG_FILE"]
            if before is not None:
                os.environ["ROS_PYTHON_LOG_CONFIG_FILE"] = before


def _own_address(master: str) -> str:
    """Our address as the master's network sees it, so that robots can reach us without a name service.

    Raises:
        LinkError: the master's host has no address.
    """
    host, port = urlsplit(master).hostname, urlsplit(master).port
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((host, port))
        except OSError as error:
            raise LinkError(f"master {master}: got {error}, expected a host that can be reached") from None
        return probe.getsockname()[0]


def _leave_with_main_thread(rospy: Any) -> None:
    """rospy's queues are threads that would keep a finished process alive."""
    threading.main_thread().join()
    rospy.signal_shutdown("the program ended")
