#!/bin/bash
# mcap-protobuf-support 0.6.0 and mcap-ros2-support 0.6.0: a DecoderFactory that has read one MCAP file decodes the
# next one by the first file's schemas.
#
# An MCAP file brings its schemas along, so that it can be read without knowing who wrote it. Their ids are numbers of
# this file alone: another file, with a sensor more or its topics in another order, gives them to other schemas. The
# factories keep what they made of a schema by its id and look at nothing else afterwards. A loop over recordings with
# one factory outside of it is all that it takes. Protobuf skips fields that it does not know, so a box comes out as a
# cloud without points; ROS 2 messages have no field numbers at all, so that a definition whose fields changed places
# between two recordings has them swapped. Either may end in an error, and then one is lucky. The documentation says
# nothing on it; several projects found out by wrong data (yaak-ai/rbyte issue 54, NeuracoreAI/neuracore pull request
# 978).
#
# Way out: make_reader(stream, decoder_factories=[DecoderFactory()]) for each file, inside the loop.
#
# Seen (2026-11-30), the second file read with a factory of its own; with that of the first file
#     protobuf, schema 1 is foxglove.PointCloud in the first, SceneUpdate in the second: SceneUpdate of 1 box;
#         PointCloud of 0 bytes
#     ros2msg, avp/msg/Box is length, width in the first, width, length in the second; its length, width: 4.5, 1.8;
#         1.8, 4.5
# Ends with 0 while this is so, with 1 if it changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mcap==1.6.0 mcap-protobuf-support==0.6.0 mcap-ros2-support==0.6.0 \
    foxglove-schemas-protobuf==0.4.0 protobuf==7.36.2
"$folder/venv/bin/python" - <<'PYTHON'
import io
import sys

from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from mcap_ros2.writer import Writer as Ros2Writer


def protobuf_file(topic, message):
    stream = io.BytesIO()
    with ProtobufWriter(stream) as writer:
        writer.write_message(topic, message, log_time=0, publish_time=0)
    return stream.getvalue()


def ros2_file(*fields):
    stream = io.BytesIO()
    with Ros2Writer(stream) as writer:
        schema = writer.register_msgdef("avp/msg/Box", "\n".join(f"float64 {field}" for field in fields))
        box = {"length": 4.5, "width": 1.8}
        writer.write_message("/box", schema, {field: box[field] for field in fields}, log_time=0, publish_time=0)
    return stream.getvalue()


def read(content, factory):
    """Name of the schema in the file, and the message."""
    ((schema, _, _, message),) = make_reader(io.BytesIO(content), decoder_factories=[factory]).iter_decoded_messages()
    return schema.name, message


def told(message):
    kind = type(message).__name__
    if kind == "SceneUpdate":
        return f"SceneUpdate of {len(message.entities)} box"
    return f"PointCloud of {len(message.data)} bytes" if kind == "PointCloud" else f"{message.length}, {message.width}"


cloud = PointCloud(frame_id="ego", point_stride=16, data=bytes(160))
scene = SceneUpdate()
scene.entities.add(id="car", frame_id="ego").cubes.add()
found = {}
for name, factory, first, second in (
    ("protobuf", ProtobufFactory, protobuf_file("/points", cloud), protobuf_file("/truth", scene)),
    ("ros2msg", Ros2Factory, ros2_file("length", "width"), ros2_file("width", "length")),
):
    _, alone = read(second, factory())
    shared = factory()
    read(first, shared)
    schema, after = read(second, shared)
    found[name] = told(alone), told(after)
    print(f"{name}, {schema}: {found[name][0]}; {found[name][1]}")
as_seen = found["protobuf"] == ("SceneUpdate of 1 box", "PointCloud of 0 bytes")
as_seen &= found["ros2msg"] == ("4.5, 1.8", "1.8, 4.5")
print("as seen" if as_seen else "changed")
sys.exit(0 if as_seen else 1)
PYTHON
