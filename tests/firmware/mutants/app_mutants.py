"""Mistakes in what the Betaflight app may do: its motor wizards, and saves of which a part is refused."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

HANDOVER = "firmware_handover.c"
SERVICES = "background_services.c"
COMMANDS, COMMAND, BACKGROUND = "msp/msp_commands.c", "motors/dshot_command.c", "background.c"
LISTS = "msp/msp_lists.c"
OF_WIZARDS, OF_SEQUENCES = "joined/test_wizards.py", "joined/test_wizard_sequences.py"
OF_PARTS, CONFIGURE = "joined/test_partial_saves.py", "msp/msp_configure.c"
OF_SLOTS, OF_TABS = "host/test_app_slots.py", "host/test_app_tabs.py"

APP_MUTANTS = (
    Mutant(
        name="a wizard opens a test by any values",
        file=COMMANDS,
        old="\t\twizard &= us <= WIZARD_MAX_US;\n",
        new="",
        tests=(OF_WIZARDS,),
    ),
    Mutant(
        name="a wizard's test bears the values of the sliders'",
        file=SERVICES,
        old="\t\tif (disabled)\n\t\t\tfw->motor_test.most = NF_MOTOR_WIZARD_MAX;\n",
        new="",
        tests=(OF_SEQUENCES,),
    ),
    Mutant(
        name="commands go to motors that turn",
        file=SERVICES,
        old="!fw->status.trace.armed && !motor_test_open(&fw->motor_test));",
        new="!fw->status.trace.armed);",
        tests=(OF_WIZARDS,),
    ),
    Mutant(
        name="any command may follow another",
        file=COMMAND,
        old="(next != 0 && next != NF_DSHOT_COMMAND_SAVE)",
        new="false",
        tests=(OF_WIZARDS,),
    ),
    Mutant(
        name="flash may be written while a test has values",
        file=HANDOVER,
        old="!motor_test_open(test) && test->left == 0 &&",
        new="test->left != 1 &&",
        tests=(OF_SEQUENCES,),
    ),
    Mutant(
        name="flash may be written while a test's last values are at the motors",
        file=HANDOVER,
        old="!motor_test_open(test) && test->left == 0 &&",
        new="!motor_test_open(test) &&",
        tests=(OF_WIZARDS,),
    ),
    Mutant(
        name="a refused range leaves behind the one before it",
        file=LISTS,
        old="\t(void)settings_set_whole(view->settings, SETTING_AT_mode1 + slot, 0);\n",
        new="",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="a save tells once too often that some was refused",
        file=COMMANDS,
        old="\tq->peer->spoilt = false;\n",
        new="",
        tests=(OF_SLOTS, OF_TABS),
    ),
    Mutant(
        name="the line that is spoken over may be taken away",
        file=LISTS,
        old="uart3_function, choice);\n\treturn NF_REFUSAL_RANGE;",
        new="uart3_function, choice);\n\treturn NF_REFUSAL_NONE;",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="some of the motors' outputs may be taken",
        file=LISTS,
        old="\t\t    NF_REFUSAL_NONE)\n\t\t\treturn NF_REFUSAL_PAYLOAD;\n\treturn NF_REFUSAL_NONE;",
        new="\t\t    NF_REFUSAL_NONE)\n\t\t\treturn NF_REFUSAL_RANGE;\n\treturn NF_REFUSAL_NONE;",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="what contradicts other settings is taken where that alone cannot be undone",
        file=CONFIGURE,
        old="\t\ttold &= settings_conflict(changed) == NF_SETTING_COUNT;\n",
        new="",
        tests=(OF_TABS,),
    ),
    Mutant(
        name="what contradicts other settings is taken",
        file=CONFIGURE,
        old="\t\tsettings_undo(changed, settings);\n"
        "\t\ttold &= settings_conflict(changed) == NF_SETTING_COUNT;\n",
        new="",
        tests=(OF_PARTS,),
    ),
    Mutant(
        name="a motor test opens while a restart is under way",
        file=SERVICES,
        old="fw->status.state == NF_FLIGHT_DISARMED && !background->rebooting);",
        new="fw->status.state == NF_FLIGHT_DISARMED);",
        tests=(
            "joined/test_line_interlock.py::test_nothing_arms_and_nothing_turns_when_a_reboot_is_under_way",
        ),
    ),
)
