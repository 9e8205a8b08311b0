"""Mistakes in command_line/, in what joins it with a port, and in settings as text."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

SESSION = "command_line/session.c"
SERVICES = "background_services.c"
LINE, MOTOR = "command_line/command_line.c", "command_line/motor_commands.c"
LISTING, SETTING, REPORT = (
    "command_line/listing_commands.c",
    "command_line/setting_commands.c",
    "command_line/report_commands.c",
)
PORT, BACKGROUND = "msp/msp_port.c", "background.c"
TEXT, DECIMAL = "storage/settings_text.c", "common/decimal.c"
OF_SESSION, OF_MOTOR, OF_SETTINGS = (
    "command_line/test_session.py",
    "command_line/test_motor.py",
    "command_line/test_settings.py",
)
OF_TEXT, OF_DECIMAL = "storage/test_settings_text.py", "common/test_decimal.py"

COMMAND_LINE_MUTANTS = (
    Mutant(
        name="a command line opens while armed",
        file=SERVICES,
        old="const bool refused = open && firmware_armed(fw);",
        new="const bool refused = false;",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="arming is allowed while a command line is open",
        file=SERVICES,
        old="firmware_forbid(fw, NF_ARMING_REASON_CLI, background->sessions > 0);",
        new="firmware_forbid(fw, NF_ARMING_REASON_CLI, false);",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="arming stays forbidden when a command line has ended",
        file=SESSION,
        old="\t(void)cl->services->session(cl->services->context, false);\n",
        new="",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a peer that hangs up leaves its command line open",
        file=PORT,
        old="\tcommand_line_leave(&port->command_line);\n",
        new="",
        tests=(OF_SESSION, OF_MOTOR),
    ),
    Mutant(
        name="a request is no way out of the command line",
        file=PORT,
        old="\t\tcommand_line_leave(cl);\n",
        new="",
        tests=(OF_SESSION, OF_MOTOR),
    ),
    Mutant(
        name="a silent command line stays open",
        file=LINE,
        old="return command_line_samples(cl) - cl->heard > seconds * status->gyro_rate_hz;",
        new="return seconds == 0 && status == NULL;",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a line that lost bytes is carried out",
        file=LINE,
        old="\tcl->fault = COMMAND_LINE_LOST;\n",
        new="",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a line with a byte that is no text is carried out",
        file=LINE,
        old="\tif (byte < ' ' || byte > '~') {\n\t\tcommand_line_spoil(cl);\n\t} else if",
        new="\tif (byte < ' ' || byte > '~') {\n\t\treturn;\n\t} else if",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a line too long is carried out without its end",
        file=LINE,
        old="\t\tcl->fault = COMMAND_LINE_TOO_LONG;\n",
        new="\t\tcl->fault = COMMAND_LINE_GOOD;\n",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a frame's half line is carried out",
        file=LINE,
        old="\t\t\tcl->fault = COMMAND_LINE_UNENDED;\n",
        new="\t\t\tcommand_line_end_line(cl);\n",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="settings are saved after an error",
        file=LISTING,
        old="if (t->cl->failed && !force)",
        new="if (t->cl->failed && force)",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="the command line saves while motors are under test",
        file=LISTING,
        old="\tif (refusal != NF_REFUSAL_NONE)\n\t\treturn refusal;\n\tconst enum nf_refusal result",
        new="\t(void)refusal;\n\tconst enum nf_refusal result",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="the command line acknowledges faults while motors are under test",
        file=REPORT,
        old="\tif (refusal != NF_REFUSAL_NONE) {\n\t\tcommand_error(t);\n"
        '\t\tprinter_text(t->out, "faults ack: ");\n\t\tcommand_say_armed(t);\n\t\treturn;\n\t}\n',
        new="\t(void)refusal;\n",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a listing does not begin with the defaults",
        file=LISTING,
        old='printer_text(t->out, "defaults");',
        new='printer_text(t->out, "#");',
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="exit keeps what is not saved",
        file=LISTING,
        old="\t(void)settings_load(t->services->settings, t->services->flash);\n",
        new="",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="a value beyond its limits is taken without a word",
        file=SETTING,
        old="\tif (error == SETTINGS_TEXT_GOOD &&",
        new="\tif (error == SETTINGS_TEXT_GOOD || t->row == 0 ||",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="a percent of Betaflight's is taken for the whole",
        file=SETTING,
        old='\t       command_is(text, "1");',
        new='\t       command_is(text, "");',
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="the whole of a ratio is listed as a bare 1, which is refused when it is pasted",
        file=TEXT,
        old='\t\t\tsettings_text_put(&ink, ".0", 2, false);\n',
        new='\t\t\tsettings_text_put(&ink, "", 0, false);\n',
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="a motor turns although no test was opened",
        file=MOTOR,
        old="\tif (!cl->motor.allowed) {\n\t\tmotor_fail",
        new="\tif (!cl->motor.allowed && number == 0) {\n\t\tmotor_fail",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a framed command opens the motor test",
        file=MOTOR,
        old="if (t->cl->mode != COMMAND_LINE_TYPED)",
        new="if (t->cl->mode == COMMAND_LINE_CLOSED)",
        tests=(OF_SESSION,),
    ),
    Mutant(
        name="a motor turns longer than five seconds",
        file=MOTOR,
        old="*seconds <= SECONDS_MAX;",
        new="*seconds <= 2 * SECONDS_MAX;",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a motor turns on when its time is over",
        file=MOTOR,
        old="if (now - motor->since >= motor->samples) {",
        new="if (now - motor->since >= 2 * motor->samples) {",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a motor turns on when a byte comes",
        file=LINE,
        old="\tcommand_line_stop(cl);\n\tif (cl->mode == COMMAND_LINE_FRAMED)",
        new="\tif (cl->mode == COMMAND_LINE_FRAMED)",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a motor turns on when a request begins",
        file=PORT,
        old="\t\tcommand_line_stop(cl);\n\t\treturn 0;\n",
        new="\t\treturn 0;\n",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="the leave to turn motors outlives its session",
        file=SESSION,
        old="\tcl->motor.allowed = false;\n",
        new="",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="the leave to turn motors does not end",
        file=MOTOR,
        old="motor->allowed = motor->allowed && now - motor->allowed_since < LEAVE_S * status->gyro_rate_hz;",
        new="motor->allowed = motor->allowed && status;",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a motor test that was ended is not noticed",
        file=MOTOR,
        old="\tif (motor_give(cl) == NF_REFUSAL_NONE)\n\t\treturn NULL;\n\tmotor->turning = 0;",
        new="\tif (motor_give(cl) == NF_REFUSAL_NONE || now > 0)\n\t\treturn NULL;\n\tmotor->turning = 0;",
        tests=(OF_MOTOR,),
    ),
    Mutant(
        name="a number half way between two floats is rounded up",
        file=DECIMAL,
        old="fraction += count > unit || (count == unit && fraction % 2u == 1u);",
        new="fraction += count >= unit;",
        tests=(OF_DECIMAL,),
    ),
    Mutant(
        name="a number ends one place early",
        file=DECIMAL,
        old="places == DECIMAL_PLACES || decimal_bits(count, places) == bits",
        new="places + 1 == DECIMAL_PLACES || decimal_bits(count, places) == bits",
        tests=(OF_DECIMAL,),
    ),
    Mutant(
        name="a number too small for a text is kept",
        file="storage/settings.c",
        old="kept.as_float = 0.0f; /*",
        new="kept.as_float = value->as_float; /*",
        tests=("storage/test_settings.py",),
    ),
    Mutant(
        name="a text that looks like none is written as it is",
        file=TEXT,
        old="(length == 1 && text[0] == NO_TEXT));",
        new="length > NF_SETTING_TEXT_BYTES);",
        tests=(OF_TEXT,),
    ),
    Mutant(
        name="a mode range beside the grid is taken",
        file=TEXT,
        old=" ||\n\t    (us - NF_MODE_LOW_US) % NF_MODE_STEP_US != 0)",
        new=")",
        tests=(OF_TEXT,),
    ),
)
