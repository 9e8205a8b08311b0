"""Layouts of this project's messages that tell one thing of several kinds, or stream."""

from __future__ import annotations

import struct

from neuroflight.toolchain.contract.blackbox import LOG_ERASE_MAGIC, LOG_NAME_BYTES
from neuroflight.toolchain.contract.image_format import IMAGE_BUILD_BYTES, IMAGE_FIELDS, IMAGE_HEADER_FORMAT
from neuroflight.toolchain.contract.msp import MSP_STREAM_RATE_MAX_HZ, Msp
from neuroflight.toolchain.contract.msp_layouts import MspField, MspGroup, number, reply, request
from neuroflight.toolchain.contract.policy_format import SHA256_BYTES
from neuroflight.toolchain.contract.settings import SETTING_TEXT_BYTES

__all__ = ["OWN_LAYOUTS"]
_FAULT_REGISTERS = "r0 to r3, r12, lr, pc, psr, cfsr, hfsr, mmfar, bfar, sp"
_FAULT_REGISTER_COUNT = 13
_FAULT_FILE_BYTES = 24
_SETTING = number("u16", "setting", "", "its index: place in docs/reference/settings.md, from 0")
_KIND = number("u8", "kind", "", "0 u32, 1 f32, 2 mode range packed in a u32, 3 text")
_HEADER_FIELDS = ", ".join(field.name for field in IMAGE_FIELDS)
_LOG = number("u16", "log", "", "its index, from 0")
_STATE = number("u8", "state", "", "0 done, 1 under way: ask again")
_LIMIT = "as the kind says; of a text its length"


def _value(name: str, meaning: str) -> MspField:
    return MspField(name, "bytes", "", meaning, 4)


def _list(name: str, kind: str, unit: str, meaning: str) -> MspGroup:
    return MspGroup(name, (number(kind, name[:-1], unit),), counted=True, meaning=meaning)


OWN_LAYOUTS = (
    request(
        Msp.FAULTS,
        number(
            "u32", "boot", "", "acknowledges the fault that this boot found; without it nothing is changed"
        ),
        required=0,
    ),
    reply(
        Msp.FAULTS,
        number("u32", "boots", "", "the present one included"),
        number("u8", "pending", "", "1: the newest fault follows, which nobody acknowledged"),
        number("u32", "boot", "", "that found it"),
        number(
            "u32",
            "fault",
            "",
            "1 processor fault, 2 assertion, 3 watchdog, 4 brown-out, 5 crystal, 6 reset line",
        ),
        MspField("registers", "u32", "", _FAULT_REGISTERS, _FAULT_REGISTER_COUNT),
        number("u32", "line", "", "of the assertion, else the exception's number"),
        MspField("file", "text", "", "end of its path", _FAULT_FILE_BYTES),
        number("u32", "uptime", "control steps"),
        required=2,
    ),
    request(Msp.SETTING_INFO, _SETTING),
    reply(
        Msp.SETTING_INFO,
        number("u16", "count", "", "settings in all"),
        _KIND,
        _value("low", _LIMIT),
        _value("high", _LIMIT),
        _value("default", "as the kind says"),
        MspField("name", "counted"),
        MspField("unit", "counted"),
    ),
    request(Msp.SETTING_GET, _SETTING),
    reply(
        Msp.SETTING_GET,
        _KIND,
        MspField("value", "bytes", "", f"4 bytes, {SETTING_TEXT_BYTES} of a text", 0),
    ),
    request(
        Msp.SETTING_SET,
        _SETTING,
        MspField("value", "bytes", "", f"4 bytes, {SETTING_TEXT_BYTES} of a text, ended by zeros", 0),
    ),
    request(Msp.POLICY_SLOT_BEGIN, number("u32", "size", "bytes", "of the blob")),
    reply(Msp.POLICY_SLOT_BEGIN, number("u32", "sequence", "", "that the blob may have, or a newer one")),
    request(
        Msp.POLICY_SLOT_WRITE,
        number("u32", "offset", "bytes", "a multiple of 4: where the last one ended"),
        MspField("data", "bytes", "", "of the blob, a multiple of 4", 0),
    ),
    request(Msp.POLICY_SLOT_END),
    request(Msp.POLICY_SLOT_REVERT),
    request(
        Msp.POLICY_SLOT_INFO,
        number("u8", "source", "", "0 slot A, 1 slot B"),
    ),
    reply(
        Msp.POLICY_SLOT_INFO,
        number("i8", "found", "", "0 good, else an error of nf_err.h: why it could not be flown now"),
        number("u8", "flown", "", "1: by this boot"),
        number("u32", "sequence", "", "this and what follows: zeros where there is no whole policy"),
        number("u32", "architecture_hash"),
        number("u32", "filters_hash"),
        number("u32", "control_rate", "Hz"),
        number("f32", "idle", "", "motor fraction at zero thrust"),
        MspField("aircraft", "counted", "", "that it was trained on"),
        MspField("policy_sha256", "bytes", "", "of the ONNX file", SHA256_BYTES),
        MspField("build", "bytes", "", "of the image that it came with; zeros: for any", IMAGE_BUILD_BYTES),
    ),
    reply(
        Msp.IMAGE_INFO,
        number("u8", "running", "", "bank that this image runs from: 0 A, 1 B"),
        MspGroup(
            "banks",
            (
                number(
                    "u8",
                    "flags",
                    "bits",
                    "0 its header fits bank and board, else all of it is zeros; 1 numbered, 2 confirmed, "
                    "3 rejected, 4 installed by the ROM and not numbered yet",
                ),
                number("u8", "starts", "", "counted ones of an image that is not confirmed"),
                number("u32", "sequence", "", "of two numbered images the newer one is started"),
                number("u32", "image_bytes", "bytes"),
                number("u32", "crc"),
                MspField("version", "bytes", "", "major, minor, patch, 0", 4),
                MspField(
                    "build",
                    "bytes",
                    "",
                    "number of the build, the same in both banks' images",
                    IMAGE_BUILD_BYTES,
                ),
            ),
            counted=True,
        ),
        number("u8", "layout", "", "of images and flash map that this firmware knows"),
    ),
    request(
        Msp.IMAGE_BEGIN,
        MspField(
            "header", "bytes", "", f"of the image: {_HEADER_FIELDS}", struct.calcsize(IMAGE_HEADER_FORMAT)
        ),
    ),
    reply(
        Msp.IMAGE_BEGIN,
        number("u32", "offset", "bytes", "to go on from: not 0 where the same image was under way"),
    ),
    request(
        Msp.IMAGE_WRITE,
        number("u32", "offset", "bytes", "a multiple of 4: where the last one ended"),
        MspField("data", "bytes", "", "of the image, a multiple of 4", 0),
    ),
    request(Msp.IMAGE_END),
    reply(Msp.IMAGE_END, number("u32", "crc", "", "of the image as flash has it")),
    request(Msp.IMAGE_HASH, number("u8", "bank", "", "0 A, 1 B")),
    reply(Msp.IMAGE_HASH, MspField("sha256", "bytes", "", "of the image as flash has it", SHA256_BYTES)),
    request(
        Msp.IMAGE_SWITCH,
        MspField("sha256", "bytes", "", "of the image that is not run", SHA256_BYTES),
    ),
    reply(Msp.IMAGE_SWITCH, number("u32", "sequence", "", "number that the image has got")),
    reply(
        Msp.LOG_INFO,
        number("u8", "device", "", "LogDevice, as set"),
        number("u8", "state", "", "LogState"),
        number("u8", "error", "", "LogError: the device's last one, until a log begins well"),
        number(
            "u8",
            "flags",
            "bits",
            "0 a log is being written, 1 the current or last one lacks control steps, "
            "2 files are still being looked at: there may be more",
        ),
        number("u16", "logs", "", "that can be read"),
        number("u16", "empty", "", "files that can take a log"),
        number("u32", "capacity", "KiB", "of all files for logs"),
        number("u32", "free", "KiB", "of the empty ones"),
        number("u32", "frames", "", "of the current or last log"),
        number("u32", "dropped", "control steps", "that are missing in it"),
        number("u32", "bytes", "bytes", "of it"),
    ),
    request(Msp.LOG_ENTRY, _LOG),
    reply(
        Msp.LOG_ENTRY,
        _LOG,
        _STATE,
        MspField("name", "text", "", "of its file", LOG_NAME_BYTES),
        number("u32", "bytes", "bytes", "of the log, its file may be longer"),
    ),
    request(
        Msp.LOG_READ,
        _LOG,
        number("u32", "offset", "bytes"),
        number("u16", "count", "bytes", "at most"),
    ),
    reply(
        Msp.LOG_READ,
        _LOG,
        number("u32", "offset", "bytes"),
        _STATE,
        MspField("data", "bytes", "", "as many as fit; none with state 0: the log ends there", 0),
    ),
    request(Msp.LOG_ERASE, number("u32", "magic", "", f"{LOG_ERASE_MAGIC:#x}")),
    reply(Msp.LOG_ERASE, _STATE),
    request(Msp.STREAM, number("u16", "rate", "Hz", "0 ends it")),
    reply(
        Msp.STREAM,
        number(
            "u16",
            "granted",
            "Hz",
            f"the greatest divisor of the control rate not above it, nor above {MSP_STREAM_RATE_MAX_HZ}",
        ),
    ),
    reply(
        Msp.STREAM_SAMPLE,
        number("u16", "sequence", "", "counts those that were due: a gap is what the line could not take"),
        number("u32", "step", "", "control step"),
        number("u32", "cycles", "", "that it took"),
        number("u8", "state", "", "FlightState"),
        number("u8", "flags", "bits", "0 armed, 1 the PID flies"),
        MspField("setpoint", "f32", "rad/s", "", 3),
        MspField("gyro", "f32", "rad/s", "", 3),
        number("f32", "throttle", "", "0..1"),
        _list("motors", "u16", "DShot", "in motor order"),
        _list("observations", "f32", "", "none unless armed and the policy flies"),
        _list("actions", "f32", "", "none unless armed"),
    ),
)
