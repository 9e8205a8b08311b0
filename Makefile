# Neuroflight's front door. Every target works first on a fresh machine; each is one call into a room.
# Each brings the packages that it needs and no others: EXTRA is what the largest of the targets asked for needs.
# Who flashes or flies without naming a board means the one that was built for last.
TARGET   ?= $(or $(if $(filter flash emulate,$(MAKECMDGOALS)),$(shell sed -n 2p build/built 2>/dev/null)),MATEKF722)
# The folder of its outputs: the name that a TOML file gives the board.
NAME      = $(if $(filter %.toml,$(TARGET)),$(shell sed -n 's/^name = "\(.*\)"$$/\1/p' "$(TARGET)"),$(TARGET))
AIRCRAFT ?= nf1
ALGORITHM ?=
CONFIG   ?=
STEPS    ?=
SEED     ?= 1
OUT      ?= runs/$(subst :,-,$(subst .toml,,$(notdir $(AIRCRAFT))))-$(SEED)
SHIPPED   = training/policies/$(AIRCRAFT)/policy.onnx
POLICY   ?= $(if $(wildcard $(SHIPPED)),$(SHIPPED),$(OUT)/policy.onnx)
SCENARIO ?= flight
COUNT    ?= 10
ON       ?= host
JOBS     ?= $(shell expr $$(nproc) + 1)
PORT     ?=
ARGS     ?=
BUILD    ?=

# Whatever the caller says: a run has many processes, each of which would compile all that it imports.
export PYTHONDONTWRITEBYTECODE :=

VENV := .venv
# By module: where the path of the checkout holds a space, an installed script may not find its interpreter.
RUN  := $(VENV)/bin/python -m neuroflight.cli.main
# Tests call make themselves: what this call of it was told is not for them.
PYTEST = env -u MAKEFLAGS -u ARGS -u JOBS $(VENV)/bin/python -m pytest -n $(JOBS) --dist worksteal
CLANG_PACKAGES := clang libclang-rt-dev
ARM_PACKAGES := gcc-arm-none-eabi libnewlib-arm-none-eabi llvm
PEER_PACKAGES := dfu-util dosfstools gdb-multiarch mtools stm32flash

# Installs the packages $(3) where one of the programs $(1) and $(2) is missing and the system lets us. Where it does not,
# we go on without $(2), and a missing $(1) is an error.
define bring
@PATH="$$PATH:/sbin:/usr/sbin"; needed=; useful=; \
for program in $(1); do command -v $$program >/dev/null || needed="$$program"; done; \
for program in $(2); do command -v $$program >/dev/null || useful="$$program"; done; \
if [ -z "$$needed$$useful" ]; then exit 0; fi; \
if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
  echo "installing $(3)"; \
  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(3) >/dev/null; \
elif [ -n "$$needed" ]; then echo "$$needed is missing; run: sudo apt-get install $(3)" >&2; exit 1; fi
endef

IN_DEV   := setup test prove coverage bench docs lint
IN_TRAIN := train
IN_SIM   := fly view emulate
asked     = $(filter $(1),$(MAKECMDGOALS))
EXTRA    := $(if $(call asked,$(IN_DEV)),dev,$(if $(call asked,$(IN_TRAIN)),train,$(if $(call asked,$(IN_SIM)),sim,firmware)))
PYTHON   :=
TORCH    :=
READY    := $(VENV)/.$(EXTRA)$(TORCH:%=-%)

# What an image is built of: as the caller says. Who says nothing and wants to fly or flash gets what was built last,
# not the NF1's network on another aircraft; the first time, and of `make firmware`, the NF1's.
said      = $(filter-out file undefined default,$(origin $(1)))
OF       := $(if $(call said,AIRCRAFT),--aircraft "$(AIRCRAFT)")
OF       += $(if $(OF)$(call said,POLICY),--policy "$(POLICY)",$(if $(call asked,flash fly emulate),--again))
TWIN     := $(if $(call said,AIRCRAFT),--aircraft "$(AIRCRAFT)")

# Who did not ask for the build itself is told of it in one line.
BRIEF    := $(if $(call asked,firmware host),,--brief)

.PHONY: coverage help setup arm chromium clang cppcheck peers firmware flash host train fly view emulate test prove bench docs lint clean

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

setup: $(READY) ## the Python environment: [EXTRA=firmware|gateway|sim|train|sweep|dev] [PYTHON=] [TORCH=cuda]

$(READY): setup.sh pyproject.toml setup.py constraints.txt
	@PYTHON='$(PYTHON)' TORCH='$(TORCH)' ./setup.sh $(EXTRA)

arm: # the ARM compiler and llvm-mca, from the system's packages where that is allowed; it goes without llvm-mca
	$(call bring,arm-none-eabi-gcc,llvm-mca,$(ARM_PACKAGES))

firmware: $(READY) arm ## the flash image: TARGET=MATEKF722|any board|mine.toml [AIRCRAFT=nf1|mine.toml] [POLICY=path.onnx] [BUILD="--no-pid"]
	@$(RUN) image build --target "$(TARGET)" $(OF) $(BRIEF) $(BUILD)

flash: firmware ## the image, as built last, onto a board that runs Neuroflight: [PORT=/dev/ttyUSB0] [ARGS="--dry-run"]
	@$(RUN) board flash build/$(NAME)/neuroflight.nfi $(if $(PORT),--port "$(PORT)") $(ARGS)

host: $(READY) ## the same firmware as a program of this machine
	@$(RUN) image build --target HOST $(OF) $(BRIEF) $(BUILD)

train: $(READY) ## a policy from the twin: AIRCRAFT=nf1 [ALGORITHM=ppo] [CONFIG=] [STEPS=] [SEED=] [OUT=]
	@$(RUN) policy train --aircraft "$(AIRCRAFT)" $(CONFIG:%=--config %) $(ALGORITHM:%=--algorithm %) $(STEPS:%=--steps %) \
	  --seed $(SEED) --out "$(OUT)" $(ARGS)

fly: host ## a firmware against the twin: [ON=host] [SCENARIO=flight] [COUNT=10] [SEED=] [ARGS="--trace FILE.npz"]
	@$(RUN) fly --on $(ON) $(TWIN) --scenario $(SCENARIO) $(if $(call said,COUNT),--count $(COUNT)) --seed $(SEED) $(ARGS)
	@echo "next: make view" >&2

view: $(READY) ## a Split-S in 3D, as a page for the browser: [POLICY=path.onnx]
	@$(RUN) view $(POLICY) $(TWIN) --scenario sim/scenarios/split_s.toml --mount free --seed $(SEED) --out build/flight.html $(ARGS)

emulate: firmware ## the image to be flashed flies on an emulated board: roll, flip, Split-S, a minute of commands and hover
	@$(RUN) fly --on board --build build/$(NAME) $(TWIN) --seed $(SEED) \
	  --scenario roll flip sim/scenarios/split_s.toml flight $(ARGS)

test: firmware host peers ## the tests, on all cores: [JOBS=4] [ARGS=tests/sim]
	@$(PYTEST) $(ARGS)

prove: firmware host chromium clang peers ## the long version of what the tests sample: [JOBS=] [ARGS=]
	@NEUROFLIGHT_PROVES=1 $(PYTEST) -m "slow or not slow" $(ARGS)

clang: # the compiler that brings libFuzzer, as the ARM compiler is brought
	$(call bring,clang,,$(CLANG_PACKAGES))

peers: # programs of others that tests hold ours against, brought as the ARM compiler is
	$(call bring,stm32flash dfu-suffix gdb-multiarch mcopy mkfs.vfat,,$(PEER_PACKAGES))

coverage: $(READY) ## what the tests reach of the firmware's core, under sanitizers
	@$(VENV)/bin/python -m tests.coverage $(ARGS)

bench: $(READY) arm ## speed, as figures and ratios of one run
	@$(VENV)/bin/python -m tests.bench $(ARGS)

docs: $(READY) ## the documentation as a site that opens from files: build/site/index.html
	@NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --quiet
	@echo "build/site/index.html"

chromium: # the browser that shows our pages, as the ARM compiler is brought
	$(call bring,chromium,,chromium)

cppcheck: # the analyser of C, brought as the ARM compiler is
	$(call bring,cppcheck,,cppcheck)

lint: $(READY) cppcheck ## style and types; C warnings are errors in every build
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
	@find firmware -path firmware/generated -prune -o -name '*.[ch]' -print | xargs $(VENV)/bin/clang-format --dry-run -Werror
	@mkdir -p build/typed/neuroflight && ln -sfn ../../../neuroflight.py build/typed/neuroflight/__init__.py
	@for room in cli flash sim toolchain training; do ln -sfn ../../../$$room build/typed/neuroflight/$$room; done
	@$(VENV)/bin/python -m mypy & types=$$!; \
	$(VENV)/bin/python -m neuroflight.toolchain.image.cppcheck "$(POLICY)"; analysed=$$?; wait $$types && exit $$analysed

clean: ## what builds leave behind; the environment and training runs stay
	rm -rf build firmware/generated
