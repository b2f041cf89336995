# Set-up and everyday commands on a machine without a ROS 2 installation: Python 3.11 or 3.12, a C++
# compiler and make are enough. On a stock ROS 2 Jazzy machine use colcon instead (see README.md).

MAKEFLAGS += --no-builtin-rules
SCENE ?= three_axis
ARGS ?=
# The first of these that fits makes the environment.
PYTHON ?= python3.12 python3.11 python3

help:
	@echo 'make setup              prepare .venv/ and install/; every command below does it by itself'
	@echo 'make demo [SCENE=ur5]   three nodes move an arm: three_axis, ur5, panda, or a scene file'
	@echo 'make page               get the page of look, run --page and up --page (viser)'
	@echo 'make robots             get the descriptions of ur5 and panda; demo and test do it by themselves'
	@echo 'make test               run the tests; PACKAGES="core fmu": those of some packages'
	@echo 'make test-slow          run the long tests that make test leaves out'
	@echo 'make test-in-full       run the tests with every case of each class'
	@echo 'make test-peers         run the tests with masters, compilers and simulators of others'
	@echo 'make test-gpu           run the tests of fleets on a card of NVIDIA'
	@echo 'make test-under-load    run the tests of the network 20 times beside eight busy processes'
	@echo 'make fuzz               random scenes, files, messages, machines and frames, for ten minutes'
	@echo 'make bench              measure speed and accuracy'
	@echo 'make pages              measure the tables and draw the pictures of docs/ and README.md anew'
	@echo 'make tables             write the generated tables of docs/ anew'
	@echo 'make docs               build the site of the pages into out/site/'
	@echo 'make lint               check style, types and what imports what'
	@echo 'make tidy               check the names and habits of the C++ (clang-tidy)'
	@echo 'make format             put the sources into shape'
	@echo 'make clean              remove what was built; make distclean: also .venv/ and out/'
	@echo 'More arguments: ARGS="...", for example make test ARGS="-k servo"'

# What this shell knows of another ROS 2 or another environment must not mix with .venv/.
ifdef AMENT_PREFIX_PATH
unexport LD_LIBRARY_PATH
endif
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONHOME PYTHONPATH
unexport ROS_DISTRO VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp
# Hundreds of processes of the tests would translate our modules anew.
unexport PYTHONDONTWRITEBYTECODE
# Nothing that runs from here talks to other machines unless asked to.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

ACTIVATE := . .venv/bin/activate && . .venv/local_setup.sh
RUN := . .venv/bin/activate && . install/setup.sh

# $(call quietly,NAME,COMMAND) runs a command; its output goes to log/NAME.log, shown if it fails.
quietly = mkdir -p log && { { $2; } > log/$1.log 2>&1 || \
  { tail -n 30 log/$1.log; echo 'setup: failed; all of the output is in log/$1.log'; exit 1; }; }

# ---------------------------------------------------------------------------------------- set-up

setup: core install/.packages

core: .venv/.requirements install/.messages install/.core

# Holds the path of this folder. A folder that was moved, or whose Python is gone, starts anew.
HOME_OF_VENV := $(shell .venv/bin/python -IS -c pass 2>/dev/null && cat .venv/.home 2>/dev/null)

define FITS
import ensurepip, os, sys, sysconfig, venv
header = os.path.join(sysconfig.get_path("include"), "Python.h")
sys.exit(not ((3, 11) <= sys.version_info[:2] <= (3, 12) and os.path.exists(header)))
endef
export FITS

define LOCAL_SETUP
# ROS tools find the packages of this environment by it. install/setup.* reads this file.
export AMENT_PREFIX_PATH="$(CURDIR)/.venv$${AMENT_PREFIX_PATH:+:$$AMENT_PREFIX_PATH}"
export CMAKE_PREFIX_PATH="$(CURDIR)/.venv$${CMAKE_PREFIX_PATH:+:$$CMAKE_PREFIX_PATH}"
endef
export LOCAL_SETUP

.venv/.home: $(if $(filter-out $(CURDIR),$(HOME_OF_VENV)),FORCE)
	@case '$(CURDIR)' in *' '*) \
	  echo 'setup: the path of this folder must have no blank, colcon cannot take it: $(CURDIR)'; \
	  exit 1;; esac
	@rm -rf .venv build install
	@for cxx in $${CXX:-c++} g++ clang++ none; do \
	  if [ $$cxx = none ]; then \
	    echo 'setup: a C++20 compiler is needed and was not found (Debian, Ubuntu: apt install g++)'; \
	    exit 1; \
	  fi; \
	  echo '#include <concepts>' | $$cxx -std=c++20 -fsyntax-only -x c++ - 2>/dev/null && break; \
	done
	@for python in $(PYTHON) none; do \
	  if [ $$python = none ]; then \
	    echo 'setup: Python 3.11 or 3.12 with venv and headers is needed; tried $(PYTHON)' \
	      '(Debian, Ubuntu: apt install python3-dev python3-venv)'; \
	    exit 1; \
	  fi; \
	  $$python -c "$$FITS" 2>/dev/null && break; \
	done; \
	echo "setup: .venv/ with $$($$python --version)"; \
	$(call quietly,venv,$$python -m venv .venv)
	@for shell in sh bash zsh; do echo "$$LOCAL_SETUP" > .venv/local_setup.$$shell; done
	@echo '$(CURDIR)' > $@

# By uv, which takes a tenth of pip's time, or by pip.
INSTALL := .venv/bin/python tools/install.py

.venv/.requirements: requirements.txt .venv/.home
	@echo 'setup: Python packages, ROS 2 among them (1.8 GB on disk) ...'
	@$(call quietly,requirements,$(INSTALL) $<)
	@for folder in .venv/lib/python*/site-packages; do \
	  cp arm_emulator/workarounds/quiet_start.pth $$folder/a0_arm_emulator.pth; done
	@touch $@

.venv/.robots: requirements-robots.txt .venv/.requirements
	@echo 'setup: descriptions of UR5 and Panda (414 MB) ...'
	@$(call quietly,robots,$(INSTALL) $<)
	@touch $@

# Not `pip install .[page]`, which would put a copy of this checkout into the environment.
.venv/.page: requirements-peers.txt .venv/.requirements
	@echo 'setup: the page in the browser ...'
	@$(call quietly,page,.venv/bin/python -m pip install -c $< viser trimesh websockets)
	@touch $@

.venv/.peers: requirements-peers.txt .venv/.requirements
	@echo 'setup: masters of field buses, a microcontroller, a checker of FMUs ...'
	@$(call quietly,peers,$(INSTALL) $<)
	@touch $@

.venv/.bench: requirements-bench.txt .venv/.requirements
	@echo 'setup: MuJoCo ...'
	@$(call quietly,bench,$(INSTALL) $<)
	@touch $@

# Beside the requirements of the others, so that only `make docs` wants them.
.venv/.docs: requirements-docs.txt .venv/.requirements
	@echo 'setup: MkDocs ...'
	@$(call quietly,docs,$(INSTALL) $<)
	@touch $@

# The command line from any shell, with what it needs of ROS.
define COMMAND
#!/bin/sh
case ":$$AMENT_PREFIX_PATH:" in
  *'/install/arm_emulator:'*) ;;
  *) . '$(CURDIR)/.venv/bin/activate' && . '$(CURDIR)/install/setup.sh' ;;
esac
exec '$(CURDIR)/.venv/bin/python' -m arm_emulator "$$@"
endef
export COMMAND

COLCON := colcon --log-base /dev/null build --base-paths . msg packages/*

install/.messages: $(wildcard msg/* msg/srv/*) .venv/.requirements
	@echo 'setup: messages ...'
	@rm -rf build/arm_emulator_msgs install/arm_emulator_msgs
	@$(call quietly,messages,$(ACTIVATE) && $(COLCON) --packages-select arm_emulator_msgs \
	  --cmake-args -DFOR_PYTHON_ALONE=ON)
	@touch $@

# Linked, not copied: edits of Python sources, headers and configuration need no rebuild. A build by
# hand without --symlink-install removes the linked setup.py, and the next command links again.
BESIDE := $(notdir $(patsubst %/setup.py,%,$(wildcard packages/*/setup.py)))
unlinked = $(foreach name,$1,$(if $(wildcard build/$(name)/setup.py),,FORCE))
SHARED := $(shell find config launch resource -type f 2>/dev/null)
# What `pip install .` has left in the environment: a copy of this checkout, and a command that runs it.
COPIED := $(strip $(foreach name,arm_emulator $(BESIDE),\
  $(if $(wildcard .venv/lib/python*/site-packages/$(name)-*.dist-info),$(name))))
LAUNCHER := $(shell grep -ls '$(CURDIR)/install/setup.sh' .venv/bin/arm_emulator 2>/dev/null)
# $(call link,PACKAGES) builds Python packages that are used in place.
link = rm -rf $(foreach name,$1,build/$(name) install/$(name)); \
  $(call quietly,$(patsubst .%,%,$(notdir $@)),$(ACTIVATE) && $(COLCON) --packages-select $1 --symlink-install)

install/.core: package.xml setup.py setup.cfg colcon.pkg $(SHARED) install/.messages \
               $(call unlinked,arm_emulator) $(if $(COPIED)$(if $(LAUNCHER),,no),FORCE)
	@$(if $(COPIED),echo 'setup: removes the copies of this checkout that pip has installed: $(COPIED)'; \
	  $(call quietly,copy,.venv/bin/python -m pip uninstall -y $(COPIED)))
	@echo 'setup: nodes and command line ...'
	@$(call link,arm_emulator)
	@echo "$$COMMAND" > .venv/bin/arm_emulator && chmod +x .venv/bin/arm_emulator
	@touch $@

# Holds the files of commands, each of which is installed by its name.
COMMANDS := $(wildcard packages/*/*/commands/*.py)
INSTALLED := $(shell cat install/.packages 2>/dev/null)
CHANGED_COMMANDS := $(filter-out $(INSTALLED),$(COMMANDS))$(filter-out $(COMMANDS),$(INSTALLED))
install/.packages: $(wildcard packages/*.py packages/*/setup.py packages/*/package.xml) $(call unlinked,$(BESIDE)) \
                   $(if $(COPIED)$(CHANGED_COMMANDS),FORCE) | install/.core
	@echo 'setup: packages beside the core ...'
	@$(call link,$(BESIDE))
	@echo '$(COMMANDS)' > $@

# -------------------------------------------------------------------------------------- commands

# Scenes whose URDF comes from example-robot-data ask for that package.
SCENE_FILE := $(or $(wildcard config/$(SCENE).yaml),$(SCENE))
ROBOTS := $(if $(shell grep -s '^urdf: *.\?example-robot-data:' '$(SCENE_FILE)'),.venv/.robots)

page: setup .venv/.page

robots: .venv/.robots

DEMO := $(RUN) && python -m arm_emulator demo $(SCENE) $(ARGS)
ifeq ($(wildcard install/.core),)
# The first time, the scene is compiled while the messages are made.
demo: .venv/.requirements $(ROBOTS)
	@{ $(ACTIVATE) && python -m arm_emulator compile $(SCENE) > /dev/null 2>&1; } & \
	  $(MAKE) -s core && wait && $(DEMO)
else
demo: core $(ROBOTS)
	@$(DEMO)
endif

# Three files at a time on two cores, since many tests wait for processes; in the order of
# conftest.py. A worker that dies ends the run: xdist may wait for ever for the one in its place.
# Tests start hundreds of processes, so bytecode is kept whatever the environment asks for.
PYTEST := PYTHONDONTWRITEBYTECODE= pytest -n 3 --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# `make test PACKAGES="core fmu"` runs the tests of some packages alone.
PACKAGES ?=
TESTS = $(foreach name,$(PACKAGES),$(if $(filter core,$(name)),test,packages/arm_emulator_$(name)/test))

# Both by quick_cxx, which takes half of the time and gives the same bits; test-in-full tests -O3.
test: setup .venv/.robots
	@$(RUN) && CXX="$${CXX:-$(CURDIR)/test/quick_cxx}" $(PYTEST) -m 'not slow' $(TESTS) $(ARGS)

test-slow: setup .venv/.robots
	@$(RUN) && CXX="$${CXX:-$(CURDIR)/test/quick_cxx}" $(PYTEST) -m slow $(TESTS) $(ARGS)

test-in-full: setup .venv/.robots
	@$(RUN) && FULL=1 $(PYTEST) $(TESTS) $(ARGS)

# What it needs beside Python's packages is installed where that is possible, else named in a line; the
# tests that want it are then skipped.
test-peers: setup .venv/.robots .venv/.peers test-slow
	@sh test/peers/install.sh
	@$(RUN) && $(PYTEST) -n 2 $(wildcard test/peers packages/test/peers packages/*/test/peers) $(ARGS)

# Without a card every test is skipped, with a line.
test-gpu: setup
	@$(RUN) && $(PYTEST) -n 0 -s $(wildcard packages/*/test/gpu) $(ARGS)

NETWORK_TESTS := test/nodes/test_network.py test/nodes/test_lockstep.py

test-under-load: setup .venv/.robots
	@$(RUN) && python -m bench.under_load $(ARGS) -- pytest -q $(NETWORK_TESTS)

fuzz: setup .venv/.robots .venv/.peers
	@$(RUN) && PYTHONPATH=test:$$(echo test/*/ | tr ' ' :):$$PYTHONPATH python -m fuzz $(ARGS)

bench: setup .venv/.robots .venv/.bench
	@$(RUN) && python -m bench $(ARGS)

pages: setup .venv/.robots .venv/.bench
	@$(RUN) && python -m bench.pages $(ARGS)

tables: setup
	@$(RUN) && python -m docs.generated

# Warnings are errors (mkdocs.yml, `strict`); a quiet run would not count them.
docs: setup .venv/.docs
	@$(call quietly,site,$(RUN) && NO_MKDOCS_2_WARNING=1 mkdocs build)
	@echo 'docs: out/site/index.html'

CORE := $(shell find arm_emulator packages emulator_node servo_node test bench examples -path packages/arm_emulator_fieldbus/test/peers/ethercrab_master -prune -o \
  -name '*.[ch]' -print -o -name '*.[ch]pp' -print 2>/dev/null)

lint: setup
	@$(RUN) && ruff check . && ruff format --check . && mypy \
	  && mypy --config-file test/mypy.ini && lint-imports --no-logo --no-cache
	@.venv/bin/python test/banned_words.py
	@.venv/bin/python test/name_checker.py
	@$(RUN) && python -m docs.generated --check
	@$(if $(CORE),.venv/bin/clang-format --dry-run -Werror $(CORE))

.venv/.tidy: requirements-tidy.txt .venv/.requirements
	@echo 'setup: clang-tidy (149 MB) ...'
	@$(call quietly,tidy,$(INSTALL) $<)
	@touch $@

# 10 s of processor time, and a wheel of that size: not a part of lint.
tidy: setup .venv/.tidy
	@$(RUN) && python test/cpp_style.py $(ARGS)

format: setup
	@$(RUN) && ruff format . && ruff check --fix .
	@$(if $(CORE),.venv/bin/clang-format -i $(CORE))

clean:
	rm -rf build install log .mypy_cache .pytest_cache .ruff_cache

distclean: clean
	rm -rf .venv out

FORCE:
.PHONY: help setup core page robots demo test test-slow test-in-full test-peers test-gpu test-under-load fuzz bench pages tables docs lint tidy format clean distclean FORCE
