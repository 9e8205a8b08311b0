"""The link to a simulator: Betaflight's wire format, little-endian, loopback."""

from __future__ import annotations

SIM_STATE_PORT, SIM_RECEIVER_PORT = 9003, 9004
SIM_MOTOR_PORT, SIM_SERVO_PORT = 9002, 9001
SIM_POWER_PORT = 9005
SIM_STATE_FORMAT = "<18d"  # time s, rates rad/s FRD, specific force, attitude wxyz, velocity, position, Pa
SIM_RECEIVER_FORMAT = "<d16H"  # time s, 16 channels in microseconds
SIM_MOTOR_FORMAT = "<4f"  # fractions, motor 1..4
SIM_SERVO_FORMAT = "<H2x16f"  # count, pulse widths in microseconds
SIM_POWER_FORMAT = "<Id3f"  # magic, time s, volts, amps, control-time override in microseconds
SIM_POWER_MAGIC = 0x3150464E  # "NFP1"
# On the same port, before the state packet of a control step: what each ESC answered to the frame of the gyro
# sample before, by output (contract/motors.py). Without one before a control step all are silent.
SIM_ROTOR_FORMAT = "<Id8H"  # magic, time s, words
SIM_ROTOR_MAGIC = 0x3152464E  # "NFR1"
SIM_VOLTS_SCALE, SIM_AMPS_SCALE = 11.0, 17.9  # of the host program's board, as MATEKF722's: 1, mV/A
SIM_BATTERY_MV = 16800  # assumed where no simulator tells: four cells, full, at rest
SIM_GYRO_ALIGNMENT = 2  # quarter turns clockwise of the simulated chip, as on a MATEKF722
# What the controller used at a control step, sent on request (--trace-port) before the motor packet:
# magic, control step, setpoint rad/s, gyro rad/s, throttle, motor count, flags, DShot values.
SIM_TRACE_FORMAT = "<II3f3ffBB2x8H"
SIM_TRACE_MAGIC = 0x3154464E  # "NFT1"
SIM_TRACE_FLAG_ARMED = 0x01
MSP_TCP_PORT = 5761
