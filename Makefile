# make demo: two runs of the underdamped axis, with and without impulses; it installs only what they
# need. make test: all tests but those that take minutes; make soak: these, random tests with many
# more examples, and ROUNDS of faults, e.g. make soak ROUNDS='--kills 8 --stops 4 --minutes 60'.
# A sourced ROS 2 Jazzy is used where there is one; else rclpy comes from PyPI (extra "ros").
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin
SOURCED := $(and $(filter jazzy,$(ROS_DISTRO)),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes))
EXTRAS := $(if $(SOURCED),[dashboard],[dashboard,ros])

.PHONY: demo test soak check bench clean

$(VENV)/.installed: setup.py pyproject.toml setup.cfg
	$(PYTHON) -m venv $(if $(SOURCED),--system-site-packages) $(VENV)
	@echo 'installing into $(VENV): a minute or two'
	$(RUN)/python -m pip install --quiet --editable '.$(EXTRAS)'
	touch $@

$(VENV)/.test-extras: $(VENV)/.installed
	$(RUN)/python -m pip install --quiet --editable '.[test]'
	touch $@

demo: $(VENV)/.installed
	$(RUN)/python -m impulse_control_ros.tools.demo

# two at a time: most tests wait for discovery, and each has a ROS domain of its own
test: $(VENV)/.test-extras check
	$(RUN)/python -m pytest -n 2 --dist loadfile

# one at a time: some measure how soon a run goes on
ROUNDS ?= --kills 3 --stops 3 --minutes 10
soak: $(VENV)/.test-extras
	IMPULSE_SOAK=1 $(RUN)/python -m pytest -m 'soak or hypothesis' --hypothesis-profile=thorough
	IMPULSE_SOAK=1 $(RUN)/python -m test.nodes.fault_rounds $(ROUNDS)

bench: $(VENV)/.test-extras
	$(RUN)/python benchmarks/lockstep.py
	$(RUN)/python benchmarks/batch.py
	$(RUN)/python benchmarks/peers.py

check: $(VENV)/.test-extras
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy

clean:
	rm -rf $(VENV) build install log runs
