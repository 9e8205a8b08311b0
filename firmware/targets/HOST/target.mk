# The program that flies against a simulator, and its core as a shared library for tests and ports.
# x86 needs its FMA instruction named; AArch64 always has one.
CROSS :=
comma := ,
# -fshort-enums as on the chip: struct firmware has one layout.
CPUFLAGS := -fPIC -fshort-enums $(if $(filter x86_64,$(shell uname -m)),-mfma)

# The program speaks over sockets, the library to its caller; both turn rates into counts the same way.
HOST_PROGRAM_SOURCES := $(addprefix hal/host/,hal.c options.c link.c msp_tcp.c flash_file.c log_file.c replay_stream.c)
HOST_SHARED_SOURCES := $(addprefix hal/host/,board.c changes.c convert.c receiver_line.c flash_model.c replay.c)
HOST_LIBRARY_SOURCES := $(addprefix hal/host/,reference.c log_pipe.c)
HAL_SOURCES := $(HOST_PROGRAM_SOURCES) $(HOST_SHARED_SOURCES) $(HOST_LIBRARY_SOURCES)
OUTPUTS := $(BUILD)/neuroflight $(BUILD)/libneuroflight.so

host_objects = $(1:%.c=$(OBJ)/%.o)

# Recipes are expanded late, when CORE_OBJECTS and friends are known; so are these prerequisites.
.SECONDEXPANSION:
$(BUILD)/neuroflight: $$(CORE_OBJECTS) $$(MAIN_OBJECT) $$(call host_objects,$(HOST_PROGRAM_SOURCES) $(HOST_SHARED_SOURCES))
	$(CC) $(CPUFLAGS) $(INSTRUMENT) -o $@ $^

$(BUILD)/libneuroflight.so: $$(CORE_OBJECTS) $$(call host_objects,$(HOST_SHARED_SOURCES) $(HOST_LIBRARY_SOURCES))
	$(CC) $(CPUFLAGS) $(INSTRUMENT) -shared $(if $(INSTRUMENT),,-Wl$(comma)-z$(comma)defs) -o $@ $^
