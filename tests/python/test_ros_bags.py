"""Bags that ROS's tools write are read as the images they were made of, and Plumb's own open in them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

import ros_bags
from served import Daemon
from test_recordings import RECORDINGS, frames

KINDS = ["mcap", "db3", "mcap.zstd", "db3.zstd", "db3.messages", "bag", "bag.bz2", "bag.lz4"]
ENCODINGS = ["mono16", "bgr8", "rgb8", "bgra8", "rgba8", "yuv422_yuy2", "png"]
BAYER = ["bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"]
DEPTHS = ["16UC1", "32FC1", "compressedDepth"]
SHARED = next((up / "shared/data" for up in Path(__file__).resolve().parents if (up / "shared/data").is_dir()), None)


@pytest.fixture(scope="module")
def images():
    """Twelve gray images of the bundled walk."""
    messages, _ = frames(RECORDINGS / "walk.mcap")
    decoded = [cv2.imdecode(np.frombuffer(m.data, np.uint8), cv2.IMREAD_GRAYSCALE) for _, _, m, _ in messages[::12]]
    return decoded[:12]


def lens(plumb, *sources):
    """What a calibration says of the lens and of each view, to the last bit."""
    done = plumb("calibrate", "--board", "9x6", "--square", "25mm", "--lens", "brown", "--json", "--every-frame", *sources)
    document = json.loads(done.stdout)
    color = document["sensors"]["color"] if "sensors" in document else document
    return json.dumps({key: value for key, value in color.items() if key in ("lens", "rms_px", "deviations", "covariance")})


@pytest.fixture(scope="module")
def expected(plumb, images, tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for index, pixels in enumerate(images):
        cv2.imwrite(str(folder / f"{index:03}.png"), pixels)
    answer = lens(plumb, folder)
    assert "fx" in answer
    return answer


@pytest.mark.parametrize("kind", KINDS)
def test_every_storage_gives_the_calibration_of_its_images(kind, plumb, images, expected, tmp_path):
    path = tmp_path / ("front.bag" if kind.startswith("bag") else "front")
    assert lens(plumb, ros_bags.write_images(path, kind, images, "mono8")) == expected


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_lossless_encoding_gives_the_calibration_of_its_images(encoding, plumb, images, expected, tmp_path):
    assert lens(plumb, ros_bags.write_images(tmp_path / "front", "mcap", images, encoding)) == expected


def test_real_images(plumb, tmp_path):
    if SHARED is None:
        pytest.skip("no shared/data beside the project: nothing was tested on real images")
    files = sorted((SHARED / "opencv-samples").glob("left[0-9]*.jpg"))
    assert files
    bag = ros_bags.write_images(tmp_path / "left", "db3", [file.read_bytes() for file in files], "jpeg")
    assert lens(plumb, bag) == lens(plumb, *files)


def detect(plumb, *arguments, succeeds=True):
    done = plumb("detect", "--board", "9x6", "--json", *arguments, succeeds=succeeds)
    return [json.loads(line) for line in done.stdout.splitlines()] if succeeds else done.stderr


def test_several_cameras_are_several_cameras(plumb, images, tmp_path):
    with ros_bags.Bag(tmp_path / "two", "mcap") as bag:
        for index, pixels in enumerate(images[:3]):
            time_ns = ros_bags.START_NS + index * ros_bags.INTERVAL_NS
            bag.image("/left/image_raw", time_ns, pixels, "mono8")
            bag.image("/right/image_raw", time_ns, pixels[:, ::-1].copy(), "rgb8")
    line = detect(plumb, tmp_path / "two", succeeds=False)
    assert "/left/image_raw" in line and "--topic" in line and line.count("\n") == 1
    left = detect(plumb, "--topic", "/left/image_raw", tmp_path / "two")
    right = detect(plumb, "--topic", "/right", tmp_path / "two")
    assert len(left) == len(right) == 3 and all(line["found"] for line in left)
    assert left[0]["corners"] != right[0]["corners"]


@pytest.mark.parametrize("encoding", BAYER)
def test_boards_are_found_in_images_of_color_filters(encoding, plumb, images, tmp_path):
    """Interpolated from the filters' own pixels, which are a gray scene's: not bit for bit."""
    gray, filtered = (detect(plumb, ros_bags.write_images(tmp_path / name, "mcap", images[:3], name)) for name in ("mono8", encoding))
    for one, other in zip(gray, filtered, strict=True):
        assert one["found"] and other["found"]
        np.testing.assert_allclose(other["corners"], one["corners"], atol=0.1)


def sensors(plumb, *sources):
    """What a calibration of color, infrared and depth says of each, and where they are."""
    done = plumb("calibrate", "--board", "9x6", "--square", "40mm", "--lens", "brown", "--json", *sources)
    document = json.loads(done.stdout)
    # Views are named by the file; a header's stamp has less digits than the recording's device time.
    left_out = ("views", "time_offset_ms", "time_offset_std_ms")
    sensors = {name: {key: value for key, value in one.items() if key not in left_out} for name, one in document["sensors"].items()}
    return sensors, document["extrinsics"]


@pytest.fixture(scope="module")
def rgbd_sensors(plumb):
    return sensors(plumb, RECORDINGS / "rgbd.mcap")


@pytest.mark.parametrize("encoding", DEPTHS)
def test_depth_of_every_encoding_gives_the_calibration_of_the_recording(encoding, plumb, rgbd_sensors, tmp_path):
    path = tmp_path / "front"
    with ros_bags.Bag(path, "mcap") as bag:
        for topic, _, message, _ in frames(RECORDINGS / "rgbd.mcap")[0]:
            time_ns, data = message.timestamp.ToNanoseconds(), bytes(message.data)
            name = {"/front/color": "/front/image_raw", "/front/infrared": "/front/infra1/image_rect_raw"}.get(topic)
            if name:
                bag.compressed(f"{name}/compressed", time_ns, data, "mono8; jpeg compressed mono8")
                continue
            name, depth = "/front/depth/image_rect_raw", cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            if encoding == "compressedDepth":
                bag.compressed(f"{name}/compressedDepth", time_ns, bytes(12) + data, "16UC1; compressedDepth png")
            else:
                meters = np.where(depth == 0, np.nan, depth * 0.001).astype(np.float32)
                bag.image(name, time_ns, depth if encoding == "16UC1" else meters, encoding)
    assert sensors(plumb, path) == rgbd_sensors


def test_what_a_bag_states_of_a_camera_is_its_stated_calibration(plumb_binary, tmp_path):
    gray, at = np.zeros((48, 64), np.uint8), (0.015, -0.001, 0.002)
    with ros_bags.Bag(tmp_path / "bag", "db3") as bag:
        bag.transform("front_optical_frame", "front_depth_optical_frame", at)
        for topic, encoding, frame_id in (("/front/image_raw", "mono8", "front_optical_frame"),
                                          ("/front/depth/image_rect_raw", "16UC1", "front_depth_optical_frame")):
            pixels = gray if encoding == "mono8" else gray.astype(np.uint16) + 900
            bag.camera_info(topic.rpartition("/")[0] + "/camera_info", ros_bags.START_NS, (64, 48), [0.1, 0, 0, 0, 0], [50, 0, 32, 0, 51, 24, 0, 0, 1])
            for index in range(3):
                bag.image(topic, ros_bags.START_NS + index * ros_bags.INTERVAL_NS, pixels, encoding, frame_id=frame_id)
    source = f'{{ kind = "recording", path = "{tmp_path}/bag", topic = "/front" }}'
    with Daemon(plumb_binary, f'[[camera]]\nname = "front"\nsource = {source}\n', tmp_path) as plumb:
        plumb.wait_for_state(plumb.events("front"), "front", lambda status: status["state"] == "streaming")
        stated = plumb.ask("/v1/cameras/front/factory")
    lens = stated["sensors"]["color"]["lens"]
    assert [lens[name] for name in ("model", "fx", "fy", "cx", "cy", "k1")] == ["brown", 50.0, 51.0, 32.0, 24.0, 0.1]
    assert [(one["name"], one["translation"]) for one in stated["extrinsics"]] == [("color_from_depth", list(at))]


def image_bag(path, encoding="mono8", **changed):
    """A bag with one image of 64 × 48, with fields `changed`."""
    pixels = np.zeros((48, 64), np.uint8)
    with ros_bags.Bag(path, "mcap") as bag:
        fields = {"header": bag.header(ros_bags.START_NS), "height": 48, "width": 64, "encoding": encoding,
                  "is_bigendian": 0, "step": 64, "data": pixels.reshape(-1)}
        bag.write("/front/image_raw", "sensor_msgs/msg/Image", ros_bags.START_NS, **{**fields, **changed})
    return path


def test_bad_bags_are_one_line(plumb, images, tmp_path):
    def refused(path, *words):
        line = detect(plumb, path, succeeds=False)
        assert line.count("\n") == 1 and all(word in line for word in words), line

    refused(image_bag(tmp_path / "rvl", "rvl16"), "/front/image_raw", "rvl16", "mono8")
    refused(image_bag(tmp_path / "short", data=np.zeros(100, np.uint8)), "64x48", "100")
    refused(image_bag(tmp_path / "step", step=10), "64x48", "10 bytes")
    with (tmp_path / "definition.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"uint32 other\n")
        writer.add_message(writer.register_channel("/front/image_raw", "cdr", schema), 1, bytes(range(200)), 1)
        writer.finish()
    refused(tmp_path / "definition.mcap", "/front/image_raw", "sensor_msgs/Image message cannot be read")
    with ros_bags.Bag(tmp_path / "none", "db3") as bag:
        bag.transform("base", "front", (0.0, 0.0, 0.0))
    refused(tmp_path / "none", "no frames", "sensor_msgs")
    whole = ros_bags.write_images(tmp_path / "cut.bag", "bag.lz4", images[:4], "mono8")
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    refused(whole, "cut.bag")
    for kind in ("mcap", "db3"):
        folder = ros_bags.write_images(tmp_path / f"cut_{kind}", kind, images[:4], "mono8")
        file = next(folder.glob(f"*.{kind}"))
        content = file.read_bytes()
        file.write_bytes(content[: len(content) // 2])
        refused(folder, f"cut_{kind}")
        (tmp_path / "nothing").mkdir(exist_ok=True)
        file.unlink()
        refused(folder, file.name, "no such file")
    # Without its metadata a database still says all that is needed.
    folder = ros_bags.write_images(tmp_path / "bare", "db3", images[:2], "mono8")
    (folder / "metadata.yaml").unlink()
    assert len(detect(plumb, folder)) == len(detect(plumb, next(folder.glob("*.db3")))) == 2


def test_what_plumb_records_opens_in_ros(plumb, tmp_path):
    config, out = tmp_path / "plumb.toml", tmp_path / "it's run #3"
    source = f'{{ kind = "recording", path = "{RECORDINGS}/rgbd.mcap", pace = "fastest" }}'
    config.write_text(f'[[camera]]\nname = "front"\nsource = {source}\n')
    plumb("record", "--ros2", "--camera", "front", "--config", config, "--out", out)
    shipped, _ = frames(RECORDINGS / "rgbd.mcap")
    depth = [message.data for topic, _, message, _ in shipped if topic == "/front/depth"]
    color = [message for topic, _, message, _ in shipped if topic == "/front/color"]
    store = get_typestore(Stores.ROS2_JAZZY)
    with rosbag2.Reader(out) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/front/image_raw/compressed"] == len(color) == counts["/front/depth/image_rect_raw/compressedDepth"]
        read = {}
        for connection, time_ns, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns
            read.setdefault(connection.topic, []).append(message)
    assert [m.data.tobytes() for m in read["/front/image_raw/compressed"]] == [bytes(m.data) for m in color]
    assert read["/front/image_raw/compressed"][0].header.frame_id == "front_optical_frame"
    packed = read["/front/depth/image_rect_raw/compressedDepth"]
    assert [m.data.tobytes()[12:] for m in packed] == [bytes(data) for data in depth]
    with next(out.glob("*.mcap")).open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[Ros2Decoder()]).iter_decoded_messages())
    assert len(decoded) == sum(counts.values())
    assert len(detect(plumb, out)) == len(color)
