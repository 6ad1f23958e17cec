"""A ROS 2 graph without ROS: Eclipse Cyclone DDS, with the topics and types named as ROS 2 names them, on loopback only."""

import contextlib
import os
import threading
import time
from dataclasses import dataclass
from dataclasses import field as default

LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces>
<MaxMessageSize>65000B</MaxMessageSize></General><Discovery><Peers><Peer Address='127.0.0.1'/></Peers>
<LeaseDuration>{lease_s}s</LeaseDuration></Discovery></Domain></CycloneDDS>"""
os.environ.setdefault("CYCLONEDDS_URI", LOOPBACK.format(lease_s=10))

from cyclonedds.core import DDSStatus, InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct, make_idl_struct  # noqa: E402
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

# Other than those of other runs on this machine, and from ROS's own default of 0.
DOMAIN = 1 + os.getpid() % 200
PATIENCE_S = 30
"""How long anything is waited for that must happen."""


def dds(name):
    """The name in DDS of the type `package/kind/Name`."""
    package, kind, name = name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@dataclass
class Time(IdlStruct, typename=dds("builtin_interfaces/msg/Time")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename=dds("std_msgs/msg/Header")):
    stamp: Time = default(default_factory=Time)
    frame_id: str = ""


@dataclass
class String(IdlStruct, typename=dds("std_msgs/msg/String")):
    data: str = ""


@dataclass
class Image(IdlStruct, typename=dds("sensor_msgs/msg/Image")):
    header: Header = default(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    encoding: str = ""
    is_bigendian: uint8 = 0
    step: uint32 = 0
    data: sequence[uint8] = default(default_factory=bytes)


@dataclass
class CompressedImage(IdlStruct, typename=dds("sensor_msgs/msg/CompressedImage")):
    header: Header = default(default_factory=Header)
    format: str = ""
    data: sequence[uint8] = default(default_factory=bytes)


@dataclass
class RegionOfInterest(IdlStruct, typename=dds("sensor_msgs/msg/RegionOfInterest")):
    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
class CameraInfo(IdlStruct, typename=dds("sensor_msgs/msg/CameraInfo")):
    header: Header = default(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    distortion_model: str = ""
    d: sequence[float64] = default(default_factory=list)
    k: array[float64, 9] = default(default_factory=lambda: [0.0] * 9)
    r: array[float64, 9] = default(default_factory=lambda: [0.0] * 9)
    p: array[float64, 12] = default(default_factory=lambda: [0.0] * 12)
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: RegionOfInterest = default(default_factory=RegionOfInterest)


@dataclass
class Vector3(IdlStruct, typename=dds("geometry_msgs/msg/Vector3")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename=dds("geometry_msgs/msg/Quaternion")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Transform(IdlStruct, typename=dds("geometry_msgs/msg/Transform")):
    translation: Vector3 = default(default_factory=Vector3)
    rotation: Quaternion = default(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename=dds("geometry_msgs/msg/TransformStamped")):
    header: Header = default(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = default(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename=dds("tf2_msgs/msg/TFMessage")):
    transforms: sequence[TransformStamped] = default(default_factory=list)


@dataclass
class KeyValue(IdlStruct, typename=dds("diagnostic_msgs/msg/KeyValue")):
    key: str = ""
    value: str = ""


@dataclass
class DiagnosticStatus(IdlStruct, typename=dds("diagnostic_msgs/msg/DiagnosticStatus")):
    level: uint8 = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: sequence[KeyValue] = default(default_factory=list)


@dataclass
class DiagnosticArray(IdlStruct, typename=dds("diagnostic_msgs/msg/DiagnosticArray")):
    header: Header = default(default_factory=Header)
    status: sequence[DiagnosticStatus] = default(default_factory=list)


# Services: rmw_cyclonedds puts the client's identity and its count before the content.


@dataclass
class TriggerRequest(IdlStruct, typename=dds("std_srvs/srv/Trigger_Request")):
    client: uint64 = 0
    count: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


def service_message(name, **content):
    """The type of a request or reply; its messages are made with every member given."""
    return make_idl_struct(name.rpartition("/")[2], dds(name), {"client": uint64, "count": int64, **content})


TriggerResponse = service_message("std_srvs/srv/Trigger_Response", success=bool, message=str)
SetCameraInfoRequest = service_message("sensor_msgs/srv/SetCameraInfo_Request", camera_info=CameraInfo)
SetCameraInfoResponse = service_message("sensor_msgs/srv/SetCameraInfo_Response", success=bool, status_message=str)


RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
BEST_EFFORT = Policy.Reliability.BestEffort


def qos(reliability=RELIABLE, latched=False, depth=10):
    durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
    return Qos(reliability, durability, Policy.History.KeepLast(depth),
               Policy.DataRepresentation(use_cdrv0_representation=True))


def wait(participant, condition, what):
    """Waits, without polling, until DDS says that `condition` holds."""
    waits = WaitSet(participant)
    waits.attach(condition)
    woken = waits.wait(duration(seconds=PATIENCE_S))
    waits.detach(condition)
    assert woken, f"{PATIENCE_S} s without {what}"


class Publisher:
    """Publishes on the ROS topic `name`."""

    def __init__(self, participant, name, type_, prefix="rt", **how):
        self.participant, self.name = participant, name
        self.topic = Topic(participant, prefix + name, type_)
        self.writer = DataWriter(participant, self.topic, qos=qos(**how))

    def wait_for_reader(self):
        self.writer.set_status_mask(DDSStatus.PublicationMatched)
        while not self.writer.get_matched_subscriptions():
            wait(self.participant, self.writer, f"a reader of {self.name}")
            self.writer.take_status()

    def send(self, message):
        self.writer.write(message)

    @contextlib.contextmanager
    def going_on(self, messages):
        """Sends one after another, ten a second, as a driver does that nobody waits for."""
        ended = threading.Event()

        def run():
            for message in messages:
                self.send(message)
                if ended.wait(0.1):
                    return

        sending = threading.Thread(target=run)
        sending.start()
        try:
            yield
        finally:
            ended.set()
            sending.join()


class Subscriber:
    """Reads the ROS topic `name`."""

    def __init__(self, participant, name, type_, prefix="rt", **how):
        self.participant, self.name = participant, name
        self.topic = Topic(participant, prefix + name, type_)
        self.reader = DataReader(participant, self.topic, qos=qos(**how))
        self.waiting = ReadCondition(self.reader, SampleState.Any | ViewState.Any | InstanceState.Any)

    def wait_for_writer(self):
        self.reader.set_status_mask(DDSStatus.SubscriptionMatched)
        while not self.reader.get_matched_publications():
            wait(self.participant, self.reader, f"a writer of {self.name}")
            self.reader.take_status()

    def take(self):
        """The next message; waits for it."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            wait(self.participant, self.waiting, f"a message on {self.name}")
            for message in self.reader.take(1):
                if hasattr(message, "sample_info") and message.sample_info.valid_data:
                    return message
        raise AssertionError(f"{PATIENCE_S} s without a message on {self.name}")

    def take_until(self, wanted):
        """The first message that is `wanted`."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            message = self.take()
            if wanted(message):
                return message
        raise AssertionError(f"{PATIENCE_S} s without the message on {self.name}")


class Client:
    """Calls the service `name`."""

    def __init__(self, participant, name, request, response):
        self.requests = Publisher(participant, f"{name}Request", request, prefix="rq")
        self.replies = Subscriber(participant, f"{name}Reply", response, prefix="rr")
        self.count = 0

    def call(self, request):
        """Waits for the service as ROS 2 does: until both of its topics are found here."""
        self.requests.wait_for_reader()
        self.replies.wait_for_writer()
        self.count += 1
        request.client, request.count = 0x1234567890ABCDEF, self.count
        self.requests.send(request)
        return self.replies.take_until(lambda reply: (reply.client, reply.count) == (request.client, request.count))


def image(pixels, stamp_ns, encoding="mono8", frame_id="front_optical_frame"):
    """Gray or color `pixels` as a message."""
    header = Header(Time(stamp_ns // 10**9, stamp_ns % 10**9), frame_id)
    height, width = pixels.shape[:2]
    return Image(header, height, width, encoding, 0, pixels[0].nbytes, pixels.tobytes())
