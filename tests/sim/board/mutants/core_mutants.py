"""Mistakes with the core: memory, interrupts, faults and flash."""

from __future__ import annotations

from tests.sim.board.mutants.mutant import Mutant

GYRO = "hal/stm32f7/devices/gyro_chip.c"
HAL = "hal/stm32f7/hal.c"
FLASH = "hal/stm32f7/peripherals/flash_memory.c"
RUNTIME = "src/runtime.c"
LINKER = "hal/stm32f7/image.ld"
BURN = "for (volatile uint32_t i = 0; i < 4000u; ++i)\n\t\t;"  # 180 us

CORE_MUTANTS = (
    Mutant(
        name="no barrier before DMA starts",
        file="hal/stm32f7/peripherals/dma.h",
        old="\tDMA_SNDTR(s.at, 0) = count;\n\tbarrier();\n",
        new="\tDMA_SNDTR(s.at, 0) = count;\n",
        message=r"DMA\d stream \d is enabled without a barrier after the program's last store: .* a DSB",
        seconds=0.4,
    ),
    Mutant(
        name="motors' frame stored behind the barrier",
        file="hal/stm32f7/devices/motors.c",
        old="\t\tdma_start(self->stream, motor_words[i], setup.words);\n",
        new="\t\tdma_clear(self->stream);\n"
        "\t\tDMA_SM0AR(self->stream.at, 0) = (uint32_t)motor_words[i];\n"
        "\t\tDMA_SNDTR(self->stream.at, 0) = setup.words;\n\t\tbarrier();\n"
        "\t\t*(volatile uint32_t *)motor_words[i] = self->pins;\n"
        "\t\tDMA_SCR(self->stream.at, 0) |= DMA_SCR_EN;\n",
        message=r"DMA2 stream 6 is enabled without a barrier after the program's last store",
        place="motors_write",
        seconds=0.4,
    ),
    Mutant(
        name="no barrier when the vectors move to the bank",
        file="hal/stm32f7/boot/boot.c",
        old='\t__asm volatile("dsb\\n\\t"\n\t\t       "isb\\n\\t"\n\t\t       "msr',
        new='\t__asm volatile("isb\\n\\t"\n\t\t       "msr',
        message=r"SCB_VTOR is changed without a DSB right after it",
        place="boot_reset",
    ),
    Mutant(
        name="no barrier when the vectors move to ITCM",
        file="hal/stm32f7/startup/startup.c",
        old="\tSCB_VTOR = (uint32_t)fast_vectors;\n\tbarrier_instructions();\n",
        new="\tSCB_VTOR = (uint32_t)fast_vectors;\n",
        message=r"SCB_VTOR is changed without a DSB right after it",
        place="reset_handler",
    ),
    Mutant(
        name="control path as urgent as the gyro's edge",
        file="hal/stm32f7/core/core.h",
        old="PRIORITY_SAMPLE = 3,",
        new="PRIORITY_SAMPLE = PRIORITY_GYRO_EDGE,",
        message=r"the gyro's data-ready edge \(EXTI3\) has priority 1 and (SysTick|interrupt 58) has 1",
        place="interrupt_enable",
        seconds=0.4,
    ),
    Mutant(
        name="floating-point unit not enabled",
        file="hal/stm32f7/startup/startup.c",
        old="\tSCB_CPACR |= SCB_CPACR_CP10 | SCB_CPACR_CP11; /* full access (ARMv7-M B3.2.20) */\n",
        new="",
        message=r"a floating-point instruction while CPACR = 0x00000000 does not allow it",
        seconds=0.4,
    ),
    Mutant(
        name="stack overflow by a large local in the control task",
        file=RUNTIME,
        old="\tuint16_t dshot[POLICY_ACTION_COUNT];\n\n\tif (control_step) {",
        new="\tuint16_t dshot[POLICY_ACTION_COUNT];\n\tvolatile uint8_t scratch[8192];\n\n"
        "\tscratch[0] = (uint8_t)start;\n\t(void)scratch[0];\n\tif (control_step) {",
        message=r"(write|read) of \d bytes at 0x1FFF\w{4}, below DTCM: the stack overflows",
        place="runtime_sample",
        seconds=0.4,
    ),
    Mutant(
        name="stack overflow by recursion in flight",
        file="src/control/mixer.c",
        old="\treturn mixer->idle + mixer->raised + (mixer->span - mixer->raised) * throttle;\n",
        new="\tvolatile float kept = throttle;\n\n"
        "\treturn kept < 2.0f ? mixer->idle + mixer_rest(mixer, kept) * kept : kept;\n",
        message=r"below DTCM: the stack overflows",
        place="mixer_rest",
        seconds=3.6,
        flown=True,
    ),
    Mutant(
        name="null pointer read",
        file=GYRO,
        old="\tgyro.handlers = handlers; /* from here on the tick watches */",
        new="\t(void)handlers;",
        message=r"access at 0x0000000\w, in the null page",
        place="gyro_sample_handler",
        seconds=0.4,
    ),
    Mutant(
        name="null pointer called",
        file=GYRO,
        old="\tgyro.handlers->sample(gyro.handlers->context, &sample);",
        new="\tconst struct hal_handlers *volatile none = &(const struct hal_handlers){0};\n\n"
        "\tnone->sample(gyro.handlers->context, &sample);",
        message=r"a branch to 0x00000000, which is no Thumb address|execution at 0x00000000",
        place="gyro_sample_handler",
        seconds=0.4,
    ),
    Mutant(
        name="handler missing in the vector table",
        file="hal/stm32f7/startup/vectors.c",
        old="[IRQ_DMA2_STREAM2] = gyro_sample_handler,",
        new="[IRQ_DMA2_STREAM2] = 0,",
        message=r"exception 74 has no vector at 0x\w+",
        seconds=0.4,
    ),
    Mutant(
        name="handler that never clears its request",
        file=GYRO,
        old="\tREGISTER(gyro.flags) = gyro.clear;\n\tbarrier(); /* cleared before the handler can return, "
        "or it would run twice */\n",
        new="",
        message=r"the handler of exception 25 has run 1000 times in a row and leaves its request up",
        place="gyro_edge_handler",
        seconds=0.4,
    ),
    Mutant(
        name="background masks the gyro's interrupt",
        file=HAL,
        old="\t\thandlers->background(handlers->context);\n",
        new="\t\tinterrupts_disable();\n\t\thandlers->background(handlers->context);\n\t\t"
        + BURN
        + "\n\t\tinterrupts_enable();\n",
        message=r"the gyro's data-ready edge \(EXTI3\) waited \d+\.\d\d us for its handler, at most 5\.00 us "
        r"are allowed: interrupts were masked",
        seconds=1.0,
    ),
    Mutant(
        name="handler that delays the gyro's interrupt",
        file=HAL,
        old="\t\t(void)motors_write(NULL, NULL, 0, false); /* missing values stop */\n\tgyro_tick();\n",
        new="\t\t(void)motors_write(NULL, NULL, 0, false);\n\tinterrupts_disable();\n\tgyro_tick();\n\t"
        + BURN
        + "\n\tinterrupts_enable();\n",
        message=r"data-ready edge \(EXTI3\) waited .*: interrupts were masked",
        seconds=1.0,
    ),
    Mutant(
        name="handler that is as urgent as the gyro's edge",
        file=GYRO,
        old="\tgyro.until_read = gyro.divider;\n",
        new="\tgyro.until_read = gyro.divider;\n\t" + BURN + "\n",
        message=r"data-ready edge \(EXTI3\) waited .*: the handler of exception 25 ran",
        place="gyro_edge_handler",
        seconds=0.4,
        ordinary=True,
    ),
    Mutant(
        name="memory of DMA buffers closed to the core",
        file="hal/stm32f7/core/core.c",
        old="{ 0x2003C000u, 14, UNCACHED }",
        new="{ 0x2003C000u, 14, NO_ACCESS }",
        message=r"MPU region 3 \(MPU_RASR 0x1000001B\) closes 0x2003C000 to 0x2003FFFF",
        place="core_start",
    ),
    Mutant(
        name="code in RAM",
        file=LINKER,
        old="\t\titcm_end = .;\n\t} > ITCM AT > BANK",
        new="\t\titcm_end = .;\n\t} > SRAM1 AT > BANK",
        message=r"execution at 0x200[1-3]\w{4}, in RAM; code runs from flash and ITCM",
        seconds=0.05,
    ),
    Mutant(
        name="write to code",
        file="hal/stm32f7/core/core.c",
        old="\tNVIC_ISER(irq / 32u) =",
        new="\tREGISTER(0x200u + 4u * (16u + irq)) = 0x08020401u; /* the vector, in ITCM */\n"
        "\tNVIC_ISER(irq / 32u) =",
        message=r"write of 4 bytes at 0x00000\w+, in ITCM after its copy",
        place="interrupt_enable|gyro_run",
        seconds=0.4,
    ),
    Mutant(
        name="unaligned words",
        file="hal/stm32f7/startup/memory.c",
        old="& 3u) == 0u",
        new="& 0u) == 0u",
        message=r"unaligned access at 0x\w+, this instruction needs \d bytes' alignment",
        place="memcpy",
        seconds=0.6,
        flown=True,  # receiver frames are copied from where the last bytes ended
    ),
    Mutant(
        name="unaligned double word",
        file=GYRO,
        old="\tgyro_words(layout.temperature, layout.upper, 1, &sample.temperature);\n",
        new="\tuint32_t pair[2];\n\n"
        '\t__asm volatile("ldrd %0, %1, [%2]" : "=r"(pair[0]), "=r"(pair[1]) : "r"(gyro_response + 7));\n'
        "\tsample.temperature = (int16_t)pair[0];\n",
        message=r"unaligned access at 0x2000\w{4}, this instruction needs 4 bytes' alignment",
        place="gyro_sample_handler",
        seconds=0.4,
    ),
    Mutant(
        name="unaligned floats",
        file=GYRO,
        old="\tgyro_words(layout.temperature, layout.upper, 1, &sample.temperature);\n",
        new="\tfloat first;\n\n"
        '\t__asm volatile("vldmia %1, {%0}" : "=t"(first) : "r"(gyro_response + 7));\n'
        "\tsample.temperature = first > 0.0f;\n",
        message=r"unaligned access at 0x2000\w{4}, this instruction needs 4 bytes' alignment",
        place="gyro_sample_handler",
        seconds=0.4,
    ),
    Mutant(
        name="unaligned access to a register",
        file="hal/stm32f7/devices/power.c",
        old="\tADC1_CR1 = ADC1_CR1_SCAN;\n",
        new='\t__asm volatile("str %0, [%1]" ::"r"(ADC1_CR1_SCAN), "r"(0x40012006u));\n',
        message=r"unaligned access at 0x40012006, this instruction needs 4 bytes' alignment",
        place="power_start",
    ),
    Mutant(
        name="register written by a byte",
        file="hal/stm32f7/devices/power.c",
        old="\tADC1_CR1 = ADC1_CR1_SCAN;\n",
        new="\t*(volatile uint8_t *)0x40012005u = 1u;\n",
        message=r"ADC1_CR1 has a write of 8 bits, but takes 32",
        place="power_start",
        seconds=0.4,
    ),
    Mutant(
        name="division by zero",
        file=GYRO,
        old="gyro.divider = gyro.timed ? 1u : NF_GYRO_EDGE_RATE_HZ / rate_hz;",
        new="gyro.divider = NF_GYRO_EDGE_RATE_HZ / (rate_hz / 8001u);",
        message=r"division by zero",
        place="gyro_run|hal_run",
        seconds=0.4,
    ),
    Mutant(
        name="flash programmed without erasing it",
        file="src/storage/fault_log.c",
        old="return flash_program(log->flash, address, &entry,",
        new="return flash_program(log->flash, fault_log_address_of(0), &entry,",
        message=r"flash at 0x0800C\w{3} is 0x\w{8} and is to become 0x\w{8}: programming a 1 over a 0",
        seconds=0.4,
        boots=2,
    ),
    Mutant(
        name="flash driven by code in flash",
        file=LINKER,
        old="\t\t*hal/stm32f7/peripherals/flash_memory.o(.text.flash_memory_erase_sector "
        ".text.flash_memory_program_words)\n",
        new="",
        message=r"data-ready edge \(EXTI3\) waited .*: the core waited for busy flash",
        seconds=1.2,
        saves=0.5,
    ),
    Mutant(
        name="flash written while motors turn",
        file="src/background.c",
        old="static void background_run_storage(void *context)\n{\n",
        new="static void background_run_storage(void *context)\n{\n\tstatic const uint32_t mark = 0;\n"
        "\tconst struct hal *hal = ((struct background *)context)->config.board.hal;\n\n"
        "\t(void)flash_program(&hal->flash, NF_FLASH_FAULT_RECORD_ADDRESS + 0x3F00u, &mark, sizeof mark);\n",
        message=r"flash at 0x0800FF00 is programmed while motor 1 turns \(DShot value \d+\)",
        place="flash_memory_program(_words)?",
        seconds=3.8,
        flown=True,
    ),
    Mutant(
        name="flash unlocked by a wrong key",
        file="hal/stm32f7/peripherals/flash_registers.h",
        old="#define FLASH_KEY_2 0xCDEF89ABu",
        new="#define FLASH_KEY_2 0xCDEF89ACu",
        message=r"FLASH_KEYR = 0xCDEF89AC, expected 0xCDEF89AB while locked",
        seconds=0.4,
    ),
    Mutant(
        name="option bytes written while they are locked",
        file=FLASH,
        old="\tFLASH_SR = FLASH_ERRORS | FLASH_SR_EOP; /* of earlier operations */\n",
        new="\tFLASH_SR = FLASH_ERRORS | FLASH_SR_EOP;\n\tFLASH_OPTCR |= BIT(1); /* OPTSTRT */\n",
        message=r"FLASH_OPTCR is written while it is locked, expected both keys in FLASH_OPTKEYR before",
        place="flash_memory_begin",
        seconds=0.4,
    ),
    Mutant(
        name="flash written before it has rested",
        file=FLASH,
        old="(FLASH_SR & FLASH_SR_BSY) != 0u; ++look",
        new="(FLASH_SR & FLASH_SR_OPERR) != 0u; ++look",
        message=r"is written while the controller is busy, expected FLASH_SR BSY 0 before",
        seconds=0.4,
    ),
)
