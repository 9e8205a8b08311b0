"""Mistakes in firmware.c, background.c and program.c."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

FIRMWARE, BACKGROUND, PROGRAM = "firmware.c", "background.c", "program.c"
OF_FIRMWARE, OF_BACKGROUND = "joined/test_firmware.py", "joined/test_background.py"
OF_INTERLOCK, OF_PILOT = "joined/test_interlock.py", "joined/test_pilot.py"
OF_INTERRUPT, OF_TRIAL, OF_WEIGHTS = (
    "joined/test_interrupt.py",
    "joined/test_trial.py",
    "joined/test_weights.py",
)
OF_ACKNOWLEDGE, OF_BOARD = "joined/test_acknowledge.py", "joined/test_board_reasons.py"
OF_BENCH, OF_DOUBT, OF_LOST = "joined/test_motor_bench.py", "joined/test_doubt.py", "joined/test_lost.py"
SATURATED = "joined/test_faults.py::test_it_flies_a_saturated_gyro_tells_it_and_stops_when_that_lasts"

JOINED_MUTANTS = (
    Mutant(
        name="firmware_status never retries",
        file=FIRMWARE,
        old="} while (before != fw->published);",
        new="} while (before > fw->published);",
        tests=(OF_INTERRUPT,),
        slow=False,
    ),
    Mutant(
        name="a lost receiver's switch chooses the controller",
        file=FIRMWARE,
        old="return link == RECEIVER_LOST ? fw->pid_wanted : channels_us",
        new="return channels_us",
        tests=(OF_INTERLOCK,),
    ),
    Mutant(
        name="a trial goes on while nobody is heard",
        file=FIRMWARE,
        old="(link != RECEIVER_GOOD || channels_us[NF_CHANNEL_TRIAL] < NF_TRIAL_ON_US)",
        new="channels_us[NF_CHANNEL_TRIAL] < NF_TRIAL_ON_US",
        tests=(OF_TRIAL,),
    ),
    Mutant(
        name="the switch of a trial counts from above its threshold",
        file=FIRMWARE,
        old="channels_us[NF_CHANNEL_TRIAL] < NF_TRIAL_ON_US",
        new="channels_us[NF_CHANNEL_TRIAL] <= NF_TRIAL_ON_US",
        tests=(OF_TRIAL,),
    ),
    Mutant(
        name="every policy is on trial",
        file=FIRMWARE,
        old="if (fw->trial && (",
        new="if ((",
        tests=(OF_TRIAL,),
    ),
    Mutant(
        name="a saturated gyro forbids nothing",
        file=FIRMWARE,
        old="[NF_GYRO_HEALTH_SATURATED] = SAFETY_REASON(GYRO_BAD),",
        new="[NF_GYRO_HEALTH_SATURATED] = 0,",
        tests=(SATURATED,),
    ),
    Mutant(
        name="a gyro that stays at its end is flown",
        file=FIRMWARE,
        old="(gyro_railed(&fw->gyro) ? SAFETY_GYRO_SATURATED : 0u)",
        new="0u",
        tests=(SATURATED,),
    ),
    Mutant(
        name="the arming delay is not that of the setting",
        file=FIRMWARE,
        old="config->gyro_rate_hz * settings->arming_delay_ms / 1000u",
        new="config->gyro_rate_hz * NF_BOOT_GRACE_MS / 1000u",
        tests=(OF_BACKGROUND,),
    ),
    Mutant(
        name="the second flight has no runaway window",
        file=FIRMWARE,
        old="\tcrash_reset(&fw->crash);\n",
        new="",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="implausible steps of the flight before count in the next",
        file=FIRMWARE,
        old="\tplausibility_reset(&fw->plausibility);\n\tcrash_reset",
        new="\tcrash_reset",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="only the first flight is forgotten",
        file=FIRMWARE,
        old="\t\tfw->rested = false;\n",
        new="",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="control remembers the flight before",
        file=FIRMWARE,
        old="\t\tcontrol_reset(&fw->control);\n",
        new="\t\tfw->rested &= true;\n",
        tests=(OF_FIRMWARE, OF_ACKNOWLEDGE),
    ),
    Mutant(
        name="the second of two frames in one step is not looked at",
        file=FIRMWARE,
        old="\t\tif (!fw->heard)\n\t\t\tfirmware_take_frame(fw);\n",
        new="",
        tests=(OF_INTERLOCK, OF_PILOT),
    ),
    Mutant(
        name="no frame that says off ends a descent",
        file=FIRMWARE,
        old="good && !firmware_switch_on(fw) ? SAFETY_OFF_HEARD : 0u",
        new="!good && !firmware_switch_on(fw) ? SAFETY_OFF_HEARD : 0u",
        tests=(OF_BACKGROUND, OF_INTERLOCK, OF_PILOT),
    ),
    Mutant(
        name="a descent turns as the sticks last said",
        file=FIRMWARE,
        old="\ttrace->throttle = fw->failsafe_throttle;\n",
        new="",
        tests=(OF_BACKGROUND,),
    ),
    Mutant(
        name="an oscillation of the PID stops the motors",
        file=FIRMWARE,
        old="\tif (cause == NF_FALLBACK_OSCILLATION)\n\t\treturn 0;\n",
        new="",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="the PID that takes over is not relieved",
        file=FIRMWARE,
        old="\t\tcrash_relieve(&fw->crash);\n",
        new="",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="the pilot's own PID is doubted",
        file=FIRMWARE,
        old="if (!fw->doubts || !watched)",
        new="if (!fw->doubts && !watched)",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="a PID that does not help flies on",
        file=FIRMWARE,
        old="return crash_watches(&fw->crash) ? SAFETY_CRASH : 0u;",
        new="return 0u;",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="a PID that took over is not watched",
        file=FIRMWARE,
        old="fw->control.flying == CONTROLLER_POLICY || fw->control.latched;",
        new="fw->control.flying == CONTROLLER_POLICY;",
        tests=(OF_DOUBT,),
    ),
    Mutant(
        name="a policy is refused for weights that changed on the ground",
        file=FIRMWARE,
        old="\tif (safety_motors(&fw->safety))\n"
        "\t\t(void)control_distrust(&fw->control, NF_FALLBACK_WEIGHTS);",
        new="\t(void)control_distrust(&fw->control, NF_FALLBACK_WEIGHTS);",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="a policy with wrong weights may arm",
        file=FIRMWARE,
        old="\tcontrol_policy_good(&fw->control, false);\n",
        new="",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="an acknowledgement in flight is kept for the landing",
        file=FIRMWARE,
        old="\tfw->acknowledged = false;\n",
        new="",
        tests=(OF_ACKNOWLEDGE,),
    ),
    Mutant(
        name="armed motors end no command",
        file=FIRMWARE,
        old="return !fw->status.trace.armed && !motor_test_forbids(&fw->motor_test);",
        new="return !motor_test_forbids(&fw->motor_test);",
        tests=(OF_FIRMWARE, OF_BENCH, OF_INTERRUPT),
    ),
    Mutant(
        name="lost samples take no time",
        file=FIRMWARE,
        old="\t\t\t--fw->until_control;\n\t\tfirmware_tick(fw);\n",
        new="\t\t\t--fw->until_control;\n",
        tests=(OF_FIRMWARE,),
    ),
    Mutant(
        name="a control step is lost a sample too late",
        file=FIRMWARE,
        old="if (++fw->overdue < fw->control_divider)",
        new="if (++fw->overdue <= fw->control_divider)",
        tests=(OF_FIRMWARE,),
    ),
    Mutant(
        name="control steps after lost samples do not keep their times",
        file=FIRMWARE,
        old="fw->until_control = fw->control_divider - fw->overdue;",
        new="fw->until_control = fw->control_divider;",
        tests=(OF_FIRMWARE,),
    ),
    Mutant(
        name="a lost control step is not counted",
        file=FIRMWARE,
        old="\t++fw->control_steps;\n",
        new="",
        tests=(OF_FIRMWARE,),
    ),
    Mutant(
        name="flash may be written while a command is under way",
        file=FIRMWARE,
        old="return firmware_motors_stopped(fw) && !dshot_command_busy(&fw->dshot_command);",
        new="return firmware_motors_stopped(fw);",
        tests=(OF_BENCH, OF_BACKGROUND),
    ),
    Mutant(
        name="channels that wait are overwritten",
        file=FIRMWARE,
        old="\tif (fw->posted)\n\t\treturn NF_REFUSAL_ORDER;\n",
        new="",
        tests=(OF_BACKGROUND,),
    ),
    Mutant(
        name="channels may be posted after the word that they are there",
        file=FIRMWARE,
        old="\tfence();\n\tfw->posted = true;",
        new="\tfw->posted = true;",
        tests=(OF_BACKGROUND,),
        argued="the fence forbids the compiler an order that the host's compiler does not choose anyway",
    ),
    Mutant(
        name="storing looks before it forbids",
        file=BACKGROUND,
        old="\tfirmware_forbid(fw, NF_ARMING_REASON_STORING, busy || background->rebooting);\n"
        "\tif (!busy || firmware_stopped(fw))\n\t\treturn NF_REFUSAL_NONE;\n",
        new="\tconst bool stopped = firmware_stopped(fw);\n\n"
        "\tfirmware_forbid(fw, NF_ARMING_REASON_STORING, busy || background->rebooting);\n"
        "\tif (!busy || stopped)\n\t\treturn NF_REFUSAL_NONE;\n",
        tests=(OF_INTERRUPT,),
    ),
    Mutant(
        name="a refusal to store forbids arming for good",
        file=BACKGROUND,
        old="\tfirmware_forbid(fw, NF_ARMING_REASON_STORING, background->rebooting);\n"
        "\treturn NF_REFUSAL_ARMED;",
        new="\treturn NF_REFUSAL_ARMED;",
        tests=(OF_INTERRUPT, OF_BACKGROUND),
    ),
    Mutant(
        name="the same weights are checked again and again",
        file=BACKGROUND,
        old="background->weights_checked = count == left ? 0 : first + count;",
        new="background->weights_checked = 0;",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="weights are restored in flight",
        file=BACKGROUND,
        old="if (background->weights_lost || background_storing(background, true) != NF_REFUSAL_NONE)",
        new="if (background->weights_lost)",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="weights that flash does not have are good",
        file=BACKGROUND,
        old="background->weights_bad = background->weights_lost;",
        new="background->weights_bad = false;",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="nothing arms after weights were restored",
        file=BACKGROUND,
        old="\tfirmware_weights(config->firmware, !background->weights_bad);\n"
        "\t(void)background_storing(background, false);\n",
        new="\tfirmware_weights(config->firmware, !background->weights_bad);\n",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="wrong weights are found and flown",
        file=BACKGROUND,
        old="\t\tbackground->weights_bad = true;\n"
        "\t\tfirmware_weights(background->config.firmware, false);\n",
        new="\t\tbackground->weights_bad = true;\n",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="an overload forbids arming for good",
        file=BACKGROUND,
        old="\t\tstats->recent = 0;\n",
        new="",
        tests=(OF_BOARD,),
    ),
    Mutant(
        name="a load of 101 % is none",
        file=BACKGROUND,
        old="background_percent(background, stats->recent) > 100",
        new="background_percent(background, stats->recent) > 200",
        tests=(OF_BOARD,),
    ),
    Mutant(
        name="a program that waits for its samples is overloaded",
        file=BACKGROUND,
        old="\tif (!background->config.real_time)\n\t\treturn;\n",
        new="",
        tests=(OF_BOARD,),
    ),
    Mutant(
        name="a disputed alignment arms",
        file=BACKGROUND,
        old="config->alignment_disputed && background->settings.gyro_alignment == NF_GYRO_ALIGNMENT_BOARD",
        new="config->alignment_disputed && background->settings.gyro_alignment != NF_GYRO_ALIGNMENT_BOARD",
        tests=(OF_BOARD,),
    ),
    Mutant(
        name="the gesture acknowledges with the arm switch on",
        file=BACKGROUND,
        old="status.receiver_good &&\n\t\t\t     status.channels_us[NF_CHANNEL_ARM] < NF_ARM_ON_US;",
        new="status.receiver_good;",
        tests=(OF_ACKNOWLEDGE,),
    ),
    Mutant(
        name="an acknowledged fault forbids arming",
        file=BACKGROUND,
        old="\tbackground_watch_load(background);\n"
        "\tfirmware_forbid(background->config.firmware, NF_ARMING_REASON_FAULT, "
        "background->faults.pending);\n",
        new="\tbackground_watch_load(background);\n",
        tests=(OF_ACKNOWLEDGE,),
    ),
    Mutant(
        name="a policy stays refused although the pilot knows",
        file=BACKGROUND,
        old="\tif (refusal == NF_REFUSAL_NONE)\n\t\tfirmware_acknowledge(background->config.firmware);\n",
        new="",
        tests=(OF_ACKNOWLEDGE,),
    ),
    Mutant(
        name="rates are changed before their style",
        file=BACKGROUND,
        old="(change->index == style) == (pass == 0)",
        new="(change->index == style) == (pass == 1)",
        tests=(OF_BACKGROUND,),
    ),
    Mutant(
        name="the PID does not know the battery's voltage",
        file=BACKGROUND,
        old="known ? background->battery.volts : 0.0f",
        new="known ? 0.0f : background->battery.volts",
        tests=(OF_LOST,),
    ),
    Mutant(
        name="lost samples are no misses",
        file=PROGRAM,
        old="\tprogram->stats[NF_TASK_GYRO].misses += count;\n",
        new="",
        tests=(OF_LOST,),
    ),
    Mutant(
        name="a control step after lost samples has missed nothing",
        file=PROGRAM,
        old="(hal->deadline_missed(hal->context, cycles) || program->lost > 0)",
        new="hal->deadline_missed(hal->context, cycles)",
        tests=(OF_LOST,),
    ),
    Mutant(
        name="samples that were lost once are misses for ever",
        file=PROGRAM,
        old="\t\tprogram->lost = 0;\n",
        new="",
        tests=(OF_LOST,),
    ),
    Mutant(
        name="the watchdog is fed while no sample comes",
        file=PROGRAM,
        old="if (now != program->fed_at) {",
        new="if (now >= program->fed_at) {",
        tests=(OF_LOST,),
    ),
)
