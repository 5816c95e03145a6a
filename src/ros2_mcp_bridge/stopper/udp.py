"""Joining ROS over UDP alone, so that locks left by a killed process in shared memory delay nothing here.

A process that writes to a port of Fast DDS's shared memory, or waits at one, locks it. If it is killed meanwhile, the
port stays locked, and others wait for 1 s. The transports can be chosen only in an XML profile, since rmw_fastrtps adds
shared memory to any other setting where ROS is restricted to this machine. See
docs/decisions/0033-the-stopper-speaks-udp-alone.md.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from ros2_mcp_bridge.ros import participants

# Folders for the profile, in this order: where Fast DDS itself keeps files, in memory, or the one for temporary files
# if that is full. Fast DDS accepts a profile only as a file. It is deleted as soon as it has been read.
_SHARED_MEMORY = "/dev/shm"
_FOLDERS = (_SHARED_MEMORY, None)
# Free bytes in /dev/shm that a participant needs: its segment takes 0.55 MB, each of its ports 0.05 MB, with a large
# margin.
_PARTICIPANT_BYTES = 1_000_000
# Fast DDS 2 reads the first, Fast DDS 3 the second.
_PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_PROFILE_FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
# If one of these is set, the user has chosen how participants find or reach each other, and that is not changed.
_CHOSEN_VARIABLES = (*_PROFILE_VARIABLES, "FASTDDS_BUILTIN_TRANSPORTS", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS")
_RANGE, _LOCAL_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"
# The setting that rmw_fastrtps uses where ROS is restricted to this machine: no multicast, and the first 32
# participants are asked.
_STAYS_HERE = """<builtin>
    <metatrafficUnicastLocatorList><locator/></metatrafficUnicastLocatorList>
    <initialPeersList><locator><udpv4><address>127.0.0.1</address></udpv4></locator></initialPeersList>
   </builtin>"""
_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
 <profiles>
  <transport_descriptors>
   <transport_descriptor>
    <transport_id>udp</transport_id><type>UDPv4</type>{peers}
   </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="udp_alone" is_default_profile="true">
   <rtps>
    <userTransports><transport_id>udp</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
    {discovery}
   </rtps>
  </participant>
 </profiles>
</dds>
"""


def profile(*, stays_here: bool) -> str:
    """Return the XML profile; `stays_here` if ROS is restricted to this machine."""
    peers = "<maxInitialPeersRange>32</maxInitialPeersRange>" if stays_here else ""
    return _PROFILE.format(peers=peers, discovery=_STAYS_HERE if stays_here else "")


@contextmanager
def alone() -> Generator[None, None, None]:
    """A context manager in which Fast DDS participants are created without shared memory, unless the
    user has chosen transports.

    The first participant of the process has to be created in it, because the profile is read only once.
    """
    if not _is_ours_to_choose():
        yield
        return
    stays_here, former = participants.reach_is_local(), dict(os.environ)
    path = _written(profile(stays_here=stays_here))
    if path is None:  # without room for a file there is none for shared memory, either
        yield
        return
    os.environ.update(dict.fromkeys(_PROFILE_VARIABLES, str(path)))
    if stays_here:  # the profile contains the restriction
        os.environ[_RANGE] = "SYSTEM_DEFAULT"
        os.environ.pop(_LOCAL_ONLY, None)
    try:
        yield
    finally:
        for name in (*_PROFILE_VARIABLES, _RANGE, _LOCAL_ONLY):
            if name in former:
                os.environ[name] = former[name]
            else:
                os.environ.pop(name, None)
        path.unlink(missing_ok=True)


def alone_if_memory_is_full() -> AbstractContextManager[None]:
    """Return the context of `alone` if /dev/shm has no room for another participant, otherwise a context that changes
    nothing.

    Fast DDS itself would go on without shared memory, but would leave an empty file there each time.
    """
    with suppress(OSError):  # if there is no such folder
        room = os.statvfs(_SHARED_MEMORY)
        if room.f_bavail * room.f_frsize < _PARTICIPANT_BYTES:
            return alone()
    return nullcontext()


def _written(text: str) -> Path | None:
    """Write the text to a new file in the first folder that has room, and return its path; None if none has."""
    for folder in _FOLDERS:
        path = None
        try:
            descriptor, name = tempfile.mkstemp(".xml", "ros2_mcp_", folder)
            path = Path(name)
            with os.fdopen(descriptor, "w") as file:
                file.write(text)
            return path
        except OSError:
            if path:
                path.unlink(missing_ok=True)
    return None


def _is_ours_to_choose() -> bool:
    if not get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        return False
    if os.environ.get(_RANGE, "").upper() == "OFF" or any(map(os.environ.get, _CHOSEN_VARIABLES)):
        return False
    with suppress(OSError):  # a deleted working folder has no profile
        return not any((Path.cwd() / name).exists() for name in _PROFILE_FILES)
    return True
