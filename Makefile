# make demo: two runs of the underdamped axis, with and without impulses. make test: all tests.
# A sourced ROS 2 Jazzy is used where there is one; else rclpy comes from PyPI (extra "ros").
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin
SOURCED := $(and $(filter jazzy,$(ROS_DISTRO)),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes))
EXTRAS := $(if $(SOURCED),[test],[ros,test])

.PHONY: demo test check bench clean

$(VENV)/.installed: setup.py pyproject.toml setup.cfg
	$(PYTHON) -m venv $(if $(SOURCED),--system-site-packages) $(VENV)
	$(RUN)/python -m pip install --quiet --editable '.$(EXTRAS)'
	touch $@

demo: $(VENV)/.installed
	$(RUN)/python -m impulse_control_ros.tools.demo

# two at a time: most tests wait for discovery, and each has a ROS domain of its own
test: $(VENV)/.installed check
	$(RUN)/python -m pytest -n 2 --dist loadfile

bench: $(VENV)/.installed
	$(RUN)/python benchmarks/lockstep.py
	$(RUN)/python benchmarks/batch.py
	$(RUN)/python benchmarks/peers.py

check: $(VENV)/.installed
	$(RUN)/ruff check .
	$(RUN)/mypy

clean:
	rm -rf $(VENV) build install log runs
