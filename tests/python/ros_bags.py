"""Bags as ROS writes them, by `rosbags`: from images, in every storage, compression and encoding."""

from pathlib import Path

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

ROS2, ROS1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
INTERVAL_NS = 400_000_000
START_NS = 1_700_000_000_000_000_000


def raw(encoding, pixels, big_endian=False):
    """What `sensor_msgs/Image` holds of gray `pixels` (or depths), with rows padded by eight bytes."""
    if encoding in ("bgr8", "rgb8"):
        pixels = np.repeat(pixels[:, :, None], 3, 2)
    elif encoding in ("bgra8", "rgba8"):
        pixels = np.concatenate([np.repeat(pixels[:, :, None], 3, 2), np.full((*pixels.shape, 1), 255, np.uint8)], 2)
    elif encoding == "mono16":
        pixels = (pixels.astype(np.uint16) << 8 | pixels).astype(">u2" if big_endian else "<u2")
    elif encoding == "yuv422_yuy2":
        pixels = np.stack([pixels, np.full_like(pixels, 128)], 2)
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    rows = np.pad(rows, ((0, 0), (0, 8)))
    return encoding, big_endian, rows.shape[1], rows.reshape(-1)


class Bag:
    """A bag being written; `kind` is mcap, db3, mcap.zstd, db3.zstd, db3.messages, bag, bag.bz2 or bag.lz4."""

    def __init__(self, path, kind):
        self.path, self.connections = Path(path), {}
        self.ros1 = kind.startswith("bag")
        self.types = (ROS1 if self.ros1 else ROS2).types
        if self.ros1:
            self.writer = rosbag1.Writer(self.path)
            if "." in kind:
                self.writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, kind.split(".")[1].upper()))
        else:
            plugin = rosbag2.StoragePlugin.MCAP if kind.startswith("mcap") else rosbag2.StoragePlugin.SQLITE3
            self.writer = rosbag2.Writer(self.path, version=9, storage_plugin=plugin)
            mode = {"zstd": "FILE", "messages": "MESSAGE"}.get(kind.partition(".")[2])
            if mode:
                self.writer.set_compression(
                    getattr(rosbag2.CompressionMode, mode), rosbag2.CompressionFormat.ZSTD)

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def write(self, topic, type_name, time_ns, **fields):
        store = ROS1 if self.ros1 else ROS2
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, type_name, typestore=store)
        message = self.types[type_name](**fields)
        serialize = store.serialize_ros1 if self.ros1 else store.serialize_cdr
        self.writer.write(self.connections[topic], time_ns, serialize(message, type_name))

    def header(self, time_ns, frame_id="front_optical_frame"):
        stamp = self.types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **sequence)

    def image(self, topic, time_ns, pixels, encoding, late_ns=0, frame_id="front_optical_frame", **how):
        encoding, big_endian, step, data = raw(encoding, pixels, **how)
        self.write(topic, "sensor_msgs/msg/Image", time_ns + late_ns, header=self.header(time_ns, frame_id),
                   height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
                   is_bigendian=int(big_endian), step=step, data=data)

    def compressed(self, topic, time_ns, data, format):
        self.write(topic, "sensor_msgs/msg/CompressedImage", time_ns, header=self.header(time_ns),
                   format=format, data=np.frombuffer(data, np.uint8))

    def camera_info(self, topic, time_ns, size, d, k):
        upper = self.ros1
        names = {"d": d, "k": k, "r": np.eye(3).reshape(-1), "p": np.zeros(12)}
        numbers = {(name.upper() if upper else name): np.array(value, float) for name, value in names.items()}
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        self.write(topic, "sensor_msgs/msg/CameraInfo", time_ns, header=self.header(time_ns), height=size[1],
                   width=size[0], distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **numbers)

    def transform(self, parent, child, translation):
        types = self.types
        transform = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](**dict(zip("xyz", translation))),
            rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0))
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header=self.header(START_NS, parent), child_frame_id=child, transform=transform)
        self.write("/tf_static", "tf2_msgs/msg/TFMessage", START_NS, transforms=[stamped])


def write_images(path, kind, images, encoding, topic="/front/image_raw"):
    """A bag of the gray `images`, encoded as `encoding`; png and jpeg on the topic's /compressed."""
    with Bag(path, kind) as bag:
        for index, pixels in enumerate(images):
            time_ns = START_NS + index * INTERVAL_NS
            if encoding in ("png", "jpeg"):
                data = pixels if isinstance(pixels, bytes) else cv2.imencode(f".{encoding}", pixels)[1].tobytes()
                bag.compressed(topic + "/compressed", time_ns, data, f"mono8; {encoding} compressed mono8")
            else:
                bag.image(topic, time_ns, pixels, encoding)
    return path
