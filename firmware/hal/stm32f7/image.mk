# An image for an STM32F722: one ELF with the boot part (sector 0), a policy (sector 4) and bank A (sector 5). Included by target.mk.
CROSS := arm-none-eabi-
CPUFLAGS := -mcpu=cortex-m7 -mthumb -mfpu=fpv5-sp-d16 -mfloat-abi=hard -mno-unaligned-access \
	-fno-common -fno-unwind-tables -fno-asynchronous-unwind-tables -fstack-usage -fmacro-prefix-map=hal/stm32f7/=

OUTPUTS := $(addprefix $(BUILD)/neuroflight,.elf .map .bin .hex .dfu -b.elf .nfi)
BOARD_TABLE ?= $(BUILD)/board.bin
PYTHON ?= $(firstword $(wildcard ../.venv/bin/python) python3)

# The boot part is made of its own sources and of what it shares with the image, compiled once more; of its names only
# those remain that the linker needs, so that the image's may be the same.
BOOT_SOURCES := $(sort $(wildcard hal/stm32f7/boot/*.c)) hal/stm32f7/core/board.c hal/stm32f7/core/gpio.c \
	hal/stm32f7/core/led.c hal/stm32f7/startup/memory.c src/storage/image_bank.c src/port/flash.c
BOOT_OBJECTS := $(BOOT_SOURCES:%.c=$(OBJ)/boot/%.o)
HAL_SOURCES := $(filter-out hal/stm32f7/boot/%,$(sort $(wildcard hal/stm32f7/*.c hal/stm32f7/*/*.c)))

# Run before there is an FPU or memcpy; and memcpy must not become a call to itself.
STARTUP := $(OBJ)/hal/stm32f7/startup
$(STARTUP)/startup.o $(BOOT_OBJECTS): CFLAGS += -mgeneral-regs-only
$(STARTUP)/startup.o $(STARTUP)/memory.o $(BOOT_OBJECTS): CFLAGS += -fno-tree-loop-distribute-patterns
$(BOOT_OBJECTS): CFLAGS += -Os
$(OBJ)/boot/hal/stm32f7/boot/boot_crc32.o: CFLAGS += -O2

# ITCM is scarce, and most of a control step is the policy's: the core is small rather than quick.
$(OBJ)/src/%.o: CFLAGS += -Os
# But for what every step of a policy that observes much goes through number by number, or change by change.
$(addprefix $(OBJ)/src/,$(addprefix control/,estimator.o mixer.o observation.o) motors/dshot_telemetry.o \
	$(addprefix sensing/,rotors.o rpm_filter.o)): CFLAGS += -O2
# What only the background runs keeps less in registers, so that it saves and restores fewer.
$(addprefix $(OBJ)/src/,background.o background_start.o background_services.o \
	$(addsuffix /%.o,blackbox command_line msp port storage usb)): \
	CFLAGS += -fno-move-loop-invariants -fno-schedule-insns2
# The drivers are small, too, but for what delays the motors' first stop frame.
QUICK := startup/memory startup/startup
$(patsubst %.c,$(OBJ)/%.o,$(filter-out $(QUICK:%=hal/stm32f7/%.c),$(HAL_SOURCES))): CFLAGS += -Os

$(OBJ)/boot/%.o: %.c $(RECIPE)
	@mkdir -p $(@D)
	$(CC) $(CFLAGS) $(INCLUDES) -MMD -MP -c $< -o $@

-include $(BOOT_OBJECTS:.o=.d)

$(OBJ)/boot_part.o: $(BOOT_OBJECTS)
	$(CC) $(CPUFLAGS) -nostdlib -Wl,-r -o $@ $^
	$(CROSS)objcopy --keep-global-symbol=boot_vectors --keep-global-symbol=boot_reset $@

# Each bank's image is linked from the same objects, for all boards. Each board's then gets its description, and its header
# what only the whole image tells.
LINK = $(CC) $(CPUFLAGS) -nostartfiles -nostdlib -Wl,--nmagic -Wl,--gc-sections -Wl,--fatal-warnings \
	-Wl,-Map=$(@:.elf=.map) -o $@ $(filter %.o,$^) -lgcc -L $(OBJ)
IMAGE_TOOL = PYTHONPATH=.. '$(subst ','\'',$(PYTHON))' -m neuroflight.toolchain.image
STAMP = $(IMAGE_TOOL).stamp $< $(BOARD_TABLE) $@

# Which of the policy's functions run from ITCM.
$(OBJ)/policy.ld: $(OBJ)/policy.o $(wildcard ../toolchain/image/fit.py)
	$(IMAGE_TOOL).fit $< $@

.SECONDEXPANSION:
$(OBJ)/bank_a.elf: $$(CORE_OBJECTS) $$(MAIN_OBJECT) $$(HAL_OBJECTS) $(OBJ)/boot_part.o hal/stm32f7/bank_a.ld hal/stm32f7/image.ld $(OBJ)/policy.ld
	$(LINK) -T hal/stm32f7/bank_a.ld

$(OBJ)/bank_b.elf: $$(CORE_OBJECTS) $$(MAIN_OBJECT) $$(HAL_OBJECTS) hal/stm32f7/bank_b.ld hal/stm32f7/image.ld $(OBJ)/policy.ld
	$(LINK) -T hal/stm32f7/bank_b.ld

$(BUILD)/neuroflight.elf: $(OBJ)/bank_a.elf $(BOARD_TABLE)
	$(STAMP)

$(BUILD)/neuroflight-b.elf: $(OBJ)/bank_b.elf $(BOARD_TABLE) $(BUILD)/neuroflight.elf
	$(STAMP) --build-of $(BUILD)/neuroflight.elf

$(BUILD)/neuroflight.map: $(OBJ)/bank_a.elf
	cp $(<:.elf=.map) $@

# The binary is one block from the start of flash to the end of bank A's image, what lies between the parts erased: slot B,
# behind that, stays as it is. The hex file holds the parts alone, so that programming it leaves the settings as they are.
$(BUILD)/neuroflight.bin: $(BUILD)/neuroflight.elf
	$(CROSS)objcopy -O binary --gap-fill 0xFF --remove-section=.slot_b $< $@

$(BUILD)/neuroflight.hex: $(BUILD)/neuroflight.elf
	$(CROSS)objcopy -O ihex $< $@

# The same parts for the ROM's USB DFU.
$(BUILD)/neuroflight.dfu: $(BUILD)/neuroflight.elf
	$(IMAGE_TOOL).dfu $< $@

# Both banks' images and their policy, one behind the other: what is sent to a board that runs one of them.
$(BUILD)/neuroflight.nfi: $(BUILD)/neuroflight.elf $(BUILD)/neuroflight-b.elf
	$(CROSS)objcopy -O binary --remove-section=.boot --remove-section=.boot_board --remove-section=.policy --remove-section=.slot_b $< $@.a
	$(CROSS)objcopy -O binary $(word 2,$^) $@.b
	$(CROSS)objcopy -O binary --only-section=.policy $< $@.policy
	cat $@.a $@.b $@.policy > $@
	rm $@.a $@.b $@.policy
