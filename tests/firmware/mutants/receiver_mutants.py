"""Mistakes in receiver/."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

RECEIVER, RATES, GESTURE = "receiver/receiver.c", "receiver/rates.c", "receiver/gesture.c"
MODES, OF_MODES = "receiver/modes.c", "receiver/test_modes.py"
OF_RECEIVER, OF_RATES, OF_GESTURE = (
    "receiver/test_receiver.py",
    "receiver/test_rates.py",
    "receiver/test_gesture.py",
)
OF_CRSF, OF_SBUS = "receiver/test_crsf.py", "receiver/test_sbus.py"

RECEIVER_MUTANTS = (
    Mutant(
        name="one frame that says off ends a flight",
        file=RECEIVER,
        old="return goes_off && receiver->offs < NF_RECEIVER_OFF_FRAMES ?",
        new="return goes_off && receiver->offs < NF_RECEIVER_OFF_FRAMES - 1 ?",
        tests=(OF_RECEIVER,),
        slow=False,
    ),
    Mutant(
        name="frames that say off need not come in a row",
        file=RECEIVER,
        old="receiver->offs = goes_off ? (uint8_t)(receiver->offs + 1u) : 0u;",
        new="receiver->offs = goes_off ? (uint8_t)(receiver->offs + 1u) : receiver->offs;",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="one frame in failsafe ends a flight",
        file=RECEIVER,
        old="receiver->failsafes < NF_RECEIVER_OFF_FRAMES && receiver->recovering == 0",
        new="receiver->failsafes < NF_RECEIVER_OFF_FRAMES && receiver->recovering > 0",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="frames in failsafe need not come in a row",
        file=RECEIVER,
        old="\treceiver->failsafes = 0;\n\tif (frame.frame_lost)",
        new="\tif (frame.frame_lost)",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="the failsafe delay is not that of the setting",
        file=RECEIVER,
        old="gyro_rate_hz * settings->failsafe_delay_ms / 1000u",
        new="gyro_rate_hz * 1000u / 1000u",
        tests=(
            OF_RECEIVER,
            "joined/test_faults.py::test_the_stage_begins_when_silence_has_lasted_as_long_as_is_set",
        ),
    ),
    Mutant(
        name="a link recovers although its frames stay away again",
        file=RECEIVER,
        old="else if (receiver->recovering > 0 && receiver->age >= receiver->hold_after)\n"
        "\t\treceiver->recovering = receiver->recovery;\n\t",
        new="",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="a link is good again before a frame says so",
        file=RECEIVER,
        old="else if (receiver->recovering > 1)",
        new="else if (receiver->recovering > 0)",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="sticks are held a sample too long",
        file=RECEIVER,
        old="return receiver->age >= receiver->hold_after ? RECEIVER_HOLD : RECEIVER_GOOD;",
        new="return receiver->age > receiver->hold_after ? RECEIVER_HOLD : RECEIVER_GOOD;",
        tests=(OF_RECEIVER, "joined/test_interlock.py"),
    ),
    Mutant(
        name="half a frame is kept over a silence",
        file=RECEIVER,
        old="receiver->silent >= receiver->gap_after)\n\t\tprotocol",
        new="receiver->silent > receiver->gap_after)\n\t\tprotocol",
        tests=(OF_RECEIVER, "joined/test_firmware.py"),
    ),
    Mutant(
        name="channels of MSP may be anything",
        file=RECEIVER,
        old="return us >= NF_CHANNEL_VALID_MIN_US && us",
        new="return us",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="a stick that MSP does not tell is flown",
        file=RECEIVER,
        old="channels_us[receiver->map[i]] == NF_CHANNEL_UNTOLD_US",
        new="channels_us[i] == NF_CHANNEL_UNTOLD_US",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="what MSP does not tell is in a range",
        file=MODES,
        old=": NF_CHANNEL_UNTOLD_US + 1u;",
        new=": 0u;",
        tests=(OF_RECEIVER, "joined/test_modes.py"),
    ),
    Mutant(
        name="repeated channels are new ones",
        file=RECEIVER,
        old="if (frame.frame_lost)\n\t\treceiver_frame_heard(receiver, false);\n\telse\n\t\t",
        new="",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="a ramp begins where the one before ended",
        file=RECEIVER,
        old="receiver->from_us[i] = flown_us[sticks[i]];",
        new="receiver->from_us[i] = receiver->channels_us[sticks[i]];",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="a lost receiver's modes stay on",
        file=RECEIVER,
        old="return receiver_link(receiver) == RECEIVER_LOST ? 0u : receiver->on;",
        new="return receiver->on;",
        tests=(OF_RECEIVER,),
    ),
    Mutant(
        name="a range ends a microsecond early",
        file=MODES,
        old="<= range->span_us)",
        new="< range->span_us)",
        tests=(OF_MODES,),
    ),
    Mutant(
        name="a channel beyond the limits is in no range",
        file=MODES,
        old="range->high < NF_MODE_STEPS ? modes_init_us(range->high) : UINT16_MAX + 1u;",
        new="modes_init_us(range->high);",
        tests=(OF_MODES,),
    ),
    Mutant(
        name="ranges that must hold together need not",
        file=MODES,
        old="return on | (modes->joined & ~missing);",
        new="return on | modes->joined;",
        tests=(OF_MODES,),
    ),
    Mutant(
        name="an unused slot is a range",
        file=MODES,
        old="if (range.low == range.high)",
        new="if (range.low > range.high)",
        tests=(OF_MODES,),
    ),
    Mutant(
        name="only the first footer of SBUS2 is known",
        file="receiver/sbus.c",
        old="found |= footer == numbered[i];",
        new="found |= footer == numbered[0];",
        tests=(OF_SBUS, OF_RECEIVER),
    ),
    Mutant(
        name="flags that no frame has are accepted",
        file="receiver/sbus.c",
        old="#define FLAGS_UNUSED 0xF0u",
        new="#define FLAGS_UNUSED 0x00u",
        tests=(OF_SBUS, OF_RECEIVER),
    ),
    Mutant(
        name="a broken CRC is good",
        file="receiver/crsf.c",
        old="return crc8(0, bytes + TYPE, length) == 0 ? TYPE + length : 1;",
        new="return crc8(0, bytes + TYPE, length) == 0 ? TYPE + length : TYPE + length;",
        tests=(OF_CRSF,),
    ),
    Mutant(
        name="link statistics are read a byte too early",
        file="receiver/crsf.c",
        old="#define LINK_QUALITY (PAYLOAD + 2)",
        new="#define LINK_QUALITY (PAYLOAD + 1)",
        tests=(OF_CRSF,),
    ),
    Mutant(
        name="rates have no upper end",
        file=RATES,
        old="limit(styles[rates->style].curve(axis, x), 0.0f, RATE_MAX)",
        new="limit(styles[rates->style].curve(axis, x), 0.0f, 2.0f * RATE_MAX)",
        tests=(OF_RATES,),
    ),
    Mutant(
        name="the yaw stick turns the wrong way",
        file=RATES,
        old="{ NF_CHANNEL_YAW, -1.0f },",
        new="{ NF_CHANNEL_YAW, 1.0f },",
        tests=(OF_RATES,),
    ),
    Mutant(
        name="a deadband takes from the end of the stick",
        file=RATES,
        old="1.0f / (float)(HALF_STICK_US - numbers[i].deadband_us)",
        new="1.0f / (float)HALF_STICK_US",
        tests=(OF_RATES,),
    ),
    Mutant(
        name="expo is mixed the other way round",
        file=RATES,
        old="x2 * x2 * x * axis->expo + x * (1.0f - axis->expo)",
        new="x2 * x2 * x * (1.0f - axis->expo) + x * axis->expo",
        tests=(OF_RATES,),
    ),
    Mutant(
        name="the gesture is told as long as it is shown",
        file=GESTURE,
        old="if (gesture->told || ",
        new="if (",
        tests=(OF_GESTURE,),
    ),
    Mutant(
        name="the gesture's time goes on while the sticks rest",
        file=GESTURE,
        old="\t\tgesture_init(gesture);\n\t\treturn false;",
        new="\t\treturn false;",
        tests=(OF_GESTURE,),
    ),
    Mutant(
        name="the gesture does without the throttle",
        file=GESTURE,
        old="channels_us[NF_CHANNEL_THROTTLE] <= NF_THROTTLE_LOW_US &&",
        new="channels_us[NF_CHANNEL_THROTTLE] <= NF_CHANNEL_MAX_US &&",
        tests=(OF_GESTURE,),
    ),
    Mutant(
        name="old frames count for the link's quality",
        file="receiver/link_quality.c",
        old="\tslots[begins] = 0;\n",
        new="",
        tests=(OF_RECEIVER,),
    ),
)
