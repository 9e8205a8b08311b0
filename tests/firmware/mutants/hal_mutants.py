"""Mistakes in hal/stm32f7/ that the emulated board does not name by itself: an image's tests notice them."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

CHIP = "hal/stm32f7/"
FAULT, BOOT, HAL = CHIP + "core/fault.c", CHIP + "boot/boot.c", CHIP + "hal.c"
MOTORS, MSP_UART = CHIP + "devices/motors.c", CHIP + "devices/msp_uart.c"
RECEIVER_LINE = CHIP + "devices/receiver_line.c"
OF_FAULTS, OF_PORTS = "board/test_image_faults.py", "board/test_image_ports.py"
OF_MOTORS, OF_UARTS = "board/test_image_motors.py", "board/test_image_uarts.py"
OF_BOOT = "board/test_boot_part.py::test_the_old_image_is_started_at_once_when_the_new_one_is_none"

HAL_MUTANTS = (
    Mutant(
        name="a fault's frame is read beyond the stack",
        file=FAULT,
        old="at <= (uint32_t)stack_top - FRAME_BYTES)",
        new="at < (uint32_t)stack_top)",
        tests=(OF_FAULTS,),
    ),
    Mutant(
        name="a fault's frame at the bottom of the stack is not read",
        file=FAULT,
        old="at >= (uint32_t)dtcm_start",
        new="at > (uint32_t)dtcm_start",
        tests=(OF_FAULTS,),
    ),
    Mutant(
        name="an image is started on a stack beyond memory",
        file=BOOT,
        old="head->stack <= (uint32_t)dtcm_end && ",
        new="",
        tests=(OF_BOOT,),
    ),
    Mutant(
        name="an image is started on a stack below memory",
        file=BOOT,
        old="board) && head->stack > (uint32_t)dtcm_start",
        new="board) && head->stack > 0u",
        tests=(OF_BOOT,),
    ),
    Mutant(
        name="an image is started on a stack of half a double word",
        file=BOOT,
        old="head->stack % 8u == 0u",
        new="head->stack % 4u == 0u",
        tests=(OF_BOOT,),
    ),
    Mutant(
        name="an image is started in another set of instructions",
        file=BOOT,
        old="FLASH_BANK_A_SIZE && head->reset % 2u == 1u",
        new="FLASH_BANK_A_SIZE",
        tests=(OF_BOOT,),
    ),
    Mutant(
        name="a request that waits is void once its peer has paused",
        file=MSP_UART,
        old="waited == 0u && now",
        new="now",
        tests=(OF_PORTS,),
    ),
    Mutant(
        name="a reset cuts answers off",
        file=HAL,
        old="#define RESET_WAIT_MS 2500u",
        new="#define RESET_WAIT_MS 250u",
        tests=(OF_PORTS,),
    ),
    Mutant(
        name="a reset waits ten times as long for a line that does not send",
        file=HAL,
        old="#define RESET_WAIT_MS 2500u",
        new="#define RESET_WAIT_MS 25000u",
        tests=(OF_PORTS,),
    ),
    Mutant(
        name="an inverted line without a receiver is pulled high",
        file=RECEIVER_LINE,
        old=".rest = GPIO_PULL_DOWN,",
        new=".rest = GPIO_PULL_UP,",
        tests=(OF_UARTS,),
    ),
    Mutant(
        name="a plain line without a receiver is pulled low",
        file=RECEIVER_LINE,
        old=".rest = GPIO_PULL_UP,",
        new=".rest = GPIO_PULL_DOWN,",
        tests=(OF_UARTS,),
    ),
    Mutant(
        name="an output that has stuck stays silent",
        file=MOTORS,
        old="++writes_dropped % STUCK_WRITES == 0",
        new="++writes_dropped == 0",
        tests=(OF_MOTORS,),
    ),
    Mutant(
        name="a frame follows a broken one without a rest",
        file=MOTORS,
        old="\t\tif (++writes_dropped % STUCK_WRITES == 0)\n\t\t\tmotors_restart();\n\t\treturn;\n",
        new="\t\tif (++writes_dropped % STUCK_WRITES != 0)\n\t\t\treturn;\n\t\tmotors_restart();\n",
        tests=(OF_MOTORS,),
    ),
    Mutant(
        name="outputs that have not stuck are set up anew with one that has",
        file=MOTORS,
        old="\t\tif (!dma_busy(bank->stream))\n\t\t\tcontinue;\n",
        new="",
        tests=(OF_MOTORS,),
    ),
)
