# An image for an STM32F722: one ELF with the boot part (sector 0) and bank A (sector 5). Included by target.mk.
CROSS := arm-none-eabi-
CPUFLAGS := -mcpu=cortex-m7 -mthumb -mfpu=fpv5-sp-d16 -mfloat-abi=hard -mno-unaligned-access \
	-fno-common -fno-unwind-tables -fno-asynchronous-unwind-tables -fstack-usage -fmacro-prefix-map=hal/stm32f7/=

HAL_SOURCES := $(sort $(wildcard hal/stm32f7/*.c hal/stm32f7/*/*.c))
OUTPUTS := $(addprefix $(BUILD)/neuroflight.,elf bin hex)

# Run before there is an FPU or memcpy; and memcpy must not become a call to itself.
STARTUP := $(OBJ)/hal/stm32f7/startup
$(STARTUP)/startup.o $(STARTUP)/boot.o: CFLAGS += -mgeneral-regs-only
$(STARTUP)/startup.o $(STARTUP)/boot.o $(STARTUP)/memory.o: CFLAGS += -fno-tree-loop-distribute-patterns

# ITCM is scarce, and most of a control step is the policy's: the core is small rather than quick, and so is what
# waits for flash there; hal.c only joins the drivers.
$(OBJ)/src/%.o $(OBJ)/hal/stm32f7/hal.o $(OBJ)/hal/stm32f7/peripherals/flash_memory.o: CFLAGS += -Os

.SECONDEXPANSION:
$(BUILD)/neuroflight.elf: $$(CORE_OBJECTS) $$(MAIN_OBJECT) $$(HAL_OBJECTS) $(LINKER_SCRIPT)
	$(CC) $(CPUFLAGS) -nostartfiles -nostdlib -Wl,--nmagic -Wl,--gc-sections -Wl,--fatal-warnings -Wl,-Map=$(@:.elf=.map) \
		-T $(LINKER_SCRIPT) -o $@ $(filter %.o,$^) -lgcc

# The binary is one block from the start of flash, what lies between the parts erased; the hex file holds the
# two parts alone, so that programming it leaves settings and policy slots as they are.
$(BUILD)/neuroflight.bin: $(BUILD)/neuroflight.elf
	$(CROSS)objcopy -O binary --gap-fill 0xFF $< $@

$(BUILD)/neuroflight.hex: $(BUILD)/neuroflight.elf
	$(CROSS)objcopy -O ihex $< $@
