# Neuroflight's front door. Every target works first on a fresh machine; each is one call into a room.
TARGET   ?= MATEKF722
POLICY   ?= training/policies/nf1/policy.onnx
AIRCRAFT ?= nf1
ALGORITHM ?=
CONFIG   ?=
STEPS    ?=
SEED     ?= 1
OUT      ?= runs/$(basename $(notdir $(AIRCRAFT)))-$(SEED)
SCENARIO ?= pulses
COUNT    ?= 10
ON       ?= host
ARGS     ?=

VENV := .venv
RUN  := $(VENV)/bin/neuroflight
ARM_PACKAGES := gcc-arm-none-eabi libnewlib-arm-none-eabi llvm

.PHONY: coverage help setup arm cppcheck firmware host train fly emulate test prove bench lint clean

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

setup: $(VENV)/.ready ## the Python environment

$(VENV)/.ready: pyproject.toml constraints.txt
	@echo "setting up $(VENV) (once; about a minute)"
	@python3 -m venv $(VENV)
	@$(VENV)/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

arm: # the ARM compiler and llvm-mca, from the system's packages where that is allowed; it goes without llvm-mca
	@command -v arm-none-eabi-gcc >/dev/null && command -v llvm-mca >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing $(ARM_PACKAGES)"; \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(ARM_PACKAGES) >/dev/null; \
	  elif ! command -v arm-none-eabi-gcc >/dev/null; then \
	    echo "arm-none-eabi-gcc is missing; run: sudo apt-get install $(ARM_PACKAGES)" >&2; exit 1; \
	  fi; }

firmware: setup arm ## the flash image: TARGET=MATEKF722 [POLICY=path.onnx]
	@$(RUN) build --target $(TARGET) --policy $(POLICY)

host: setup ## the same firmware as a program of this machine
	@$(RUN) build --target HOST --policy $(POLICY)

train: setup ## a policy from the twin: AIRCRAFT=nf1 [ALGORITHM=ppo] [CONFIG=] [STEPS=] [SEED=] [OUT=]
	@$(RUN) train --aircraft $(AIRCRAFT) $(CONFIG:%=--config %) $(ALGORITHM:%=--algorithm %) $(STEPS:%=--steps %) \
	  --seed $(SEED) --out $(OUT) $(ARGS)

fly: host ## a firmware against the twin: [ON=host] [SCENARIO=pulses] [COUNT=10] [SEED=] [ARGS="--trace FILE.npz"]
	@$(RUN) fly --on $(ON) --aircraft $(AIRCRAFT) --scenario $(SCENARIO) --count $(COUNT) --seed $(SEED) $(ARGS)

emulate: firmware ## the image to be flashed flies on an emulated board: roll, flip, Split-S, 60 s of commands
	@$(RUN) fly --on emulator --build build/$(TARGET) --aircraft $(AIRCRAFT) --seed $(SEED) \
	  --scenario roll flip sim/scenarios/split_s.toml pulses --count 14 $(ARGS)

test: firmware host ## the tests
	@$(VENV)/bin/python -m pytest $(ARGS)

prove: firmware host ## the long version of what the tests sample
	@$(VENV)/bin/python -m pytest -m "slow or not slow" $(ARGS)

coverage: setup ## what the tests reach of the firmware's core, under sanitizers
	@$(VENV)/bin/python -m tests.coverage $(ARGS)

bench: setup arm ## speed, as figures and ratios of one run
	@$(VENV)/bin/python -m tests.bench $(ARGS)

cppcheck: # the analyser of C, brought as the ARM compiler is
	@command -v cppcheck >/dev/null || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing cppcheck"; \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends cppcheck >/dev/null; \
	  else echo "cppcheck is missing; run: sudo apt-get install cppcheck" >&2; exit 1; fi; }

lint: setup cppcheck ## style and types; C warnings are errors in every build
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check . && $(VENV)/bin/mypy
	@find firmware -path firmware/generated -prune -o -name '*.[ch]' -print | xargs $(VENV)/bin/clang-format --dry-run -Werror
	@$(VENV)/bin/python -m toolchain.image.cppcheck $(POLICY)

clean: ## what builds leave behind; the environment and training runs stay
	rm -rf build firmware/generated
