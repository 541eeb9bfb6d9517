"""Keys, tokens and attachments against rmw_zenoh's design document and zenoh-bridge-ros2dds's sources."""

import struct
from dataclasses import replace

import pytest
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.endpoints import Endpoint, Endpoints, Qos, Role, endpoints
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.rmw_zenoh import RmwZenoh, gid_of
from eigenscan.ros_bridge.ros2dds import Ros2Dds

SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
CHATTER = Endpoint("/chatter", "std_msgs/msg/String", Role.PUBLISHER, Qos(7))
STRING = (
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)


PARAMETER_SERVICES = {
    "list_parameters",
    "get_parameters",
    "get_parameter_types",
    "describe_parameters",
    "set_parameters",
}
"""All that a parameter client of ROS 2 waits for."""


def ends(**settings: object) -> Endpoints:
    return endpoints(RosBridgeOptions.model_validate(settings))


def test_keys_of_the_design_document() -> None:
    assert RmwZenoh(0, "", SESSION).key(CHATTER) == f"0/chatter/{STRING}"
    robot = replace(CHATTER, name="/robot1/chatter")
    assert RmwZenoh(2, "/robot1", SESSION).key(robot) == f"2/robot1/chatter/{STRING}"


def test_humble_has_no_hashes() -> None:
    humble = RmwZenoh(0, "", SESSION, hashed=False)
    assert humble.key(CHATTER) == "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    assert "/std_msgs::msg::dds_::String_/TypeHashNotSupported/" in list(humble.tokens([CHATTER]))[1]


def test_tokens_of_the_design_document() -> None:
    node, talker = RmwZenoh(2, "", SESSION).tokens([CHATTER])
    assert node == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%/eigenscan"
    assert talker == f"@ros2_lv/2/{SESSION}/0/1/MP/%/%/eigenscan/%chatter/{STRING}/::,7:,:,:,,"


def test_a_namespace_is_in_token_and_topic() -> None:
    robot = ends(namespace="/fleet/r17")
    tokens = list(RmwZenoh(0, "/fleet/r17", SESSION).tokens(robot))
    assert tokens[0].endswith("/NN/%/%fleet%r17/eigenscan")
    assert any("/MP/%/%fleet%r17/eigenscan/%fleet%r17%amcl_pose/" in token for token in tokens)
    assert RmwZenoh(0, "/fleet/r17", SESSION).key(robot.scans[0]).startswith("0/fleet/r17/scan/sensor_msgs::")


def test_an_absolute_topic_is_in_no_namespace() -> None:
    assert ends(namespace="r17", scan=["/front/scan"]).scans[0].name == "/front/scan"
    assert ends(namespace="r17", scan=["front/scan"]).scans[0].name == "/r17/front/scan"


@pytest.mark.parametrize(
    ("qos", "chunk"),
    [
        (Qos(10), "::,10:,:,:,,"),
        (Qos(5, reliable=False), "2::,5:,:,:,,"),
        (Qos(1, transient_local=True), ":1:,1:,:,:,,"),
        (Qos(42), "::,:,:,:,,"),
    ],
)
def test_quality_of_service_as_the_sdk_reads_it(qos: Qos, chunk: str) -> None:
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

    token = list(RmwZenoh(0, "", SESSION).tokens([replace(CHATTER, qos=qos)]))[1]
    assert token.rpartition("/")[2] == chunk
    read = QosProfile.decode(chunk)
    assert (read.reliability is QosReliability.RELIABLE) is qos.reliable
    assert (read.durability is QosDurability.TRANSIENT_LOCAL) is qos.transient_local


def test_an_attachment_is_number_time_and_id() -> None:
    from zenoh_ros2_sdk.attachment import Attachment

    dialect = RmwZenoh(0, "", SESSION)
    token = list(dialect.tokens([CHATTER]))[1]
    data = dialect.attachment(CHATTER, 3, 1_700_000_000_000_000_001)
    assert len(data) == 33
    assert Attachment.from_bytes(data) == Attachment(3, 1_700_000_000_000_000_001, gid_of(token))


def test_ids_distinguish_endpoints() -> None:
    dialect, bridge = RmwZenoh(0, "", SESSION), ends()
    ids = [dialect.attachment(endpoint, 1, 0)[17:] for endpoint in bridge]
    assert len(set(ids)) == len(ids) == 31
    tokens = [token for token in dialect.tokens(bridge) if "/NN/" not in token]
    assert ids == [gid_of(token) for token in tokens]


def test_the_lifecycle_node_is_a_node_of_its_own() -> None:
    """By its own number: `ros2 lifecycle` lists what has such services under its own name."""
    tokens = list(RmwZenoh(2, "", SESSION).tokens(ends()))
    nodes = [token for token in tokens if "/NN/" in token]
    assert [token.rpartition("/")[2] for token in nodes] == ["eigenscan", "amcl"]
    number = nodes[1].split("/")[3]
    assert nodes[1] == f"@ros2_lv/2/{SESSION}/{number}/{number}/NN/%/%/amcl"
    of_amcl = {
        token.split("/")[9] for token in tokens if token.split("/")[3] == number and "/NN/" not in token
    }
    services = {"get_state", "change_state", "get_available_states", "get_available_transitions"}
    topics = {"%bond", "%amcl%transition_event"}
    assert of_amcl == {f"%amcl%{name}" for name in services | PARAMETER_SERVICES} | topics


def test_an_id_is_xxh3_low_half_first() -> None:
    # of no bytes at all, by the algorithm's own specification: 99aa06d3014798d8 6001c324468d497f
    assert gid_of("").hex() == "7f498d4624c30160" + "d8984701d306aa99"


def test_a_reply_goes_to_who_asked() -> None:
    dialect = RmwZenoh(0, "", SESSION)
    request = struct.pack("<qqB16s", 9, 123, 16, bytes(range(16)))
    assert dialect.reply_attachment(request, 456) == struct.pack("<qqB16s", 9, 456, 16, bytes(range(16)))
    assert dialect.reply_attachment(b"", 456) is None
    assert dialect.reply_attachment(request[:-1], 456) is None


def test_a_dds_bridge_gets_topics_and_nothing_beside_them() -> None:
    dialect, bridge = Ros2Dds(SESSION), ends(namespace="r17", dialect="ros2dds")
    assert [dialect.key(endpoint) for endpoint in bridge][:2] == ["r17/scan", "r17/odom"]
    assert dialect.attachment(bridge.scans[0], 1, 0) is None  # type: ignore[func-returns-value]
    tokens = list(dialect.tokens(bridge))
    assert tokens[0] == f"@/{SESSION}/@ros2_lv"
    hashed = cdr.type_hash(cdr.POSE_WITH_COVARIANCE)
    pose = "r17§amcl_pose/geometry_msgs§msg§PoseWithCovarianceStamped"
    assert f"@/{SESSION}/@ros2_lv/MP/{pose}/:1:1::typehash={hashed};" in tokens
    assert f"@/{SESSION}/@ros2_lv/SS/r17§reinitialize_global_localization/std_srvs§srv§Empty" in tokens


def test_what_is_switched_off_is_not_there() -> None:
    bridge = ends(
        odom="",
        map="",
        particles="",
        floor="",
        diagnostics="",
        initial_pose="",
        set_initial_pose="",
        global_localization="",
        nomotion_update="",
        lifecycle="",
        tf_broadcast=False,
        mounts_from_tf=False,
    )
    parameters = [f"/eigenscan/{name}" for name in PARAMETER_SERVICES]
    assert sorted(endpoint.name for endpoint in bridge) == sorted(["/scan", "/tf", "/amcl_pose", *parameters])
    assert [endpoint.name for endpoint in ends(lifecycle="", tf="")].count("/tf") == 0
