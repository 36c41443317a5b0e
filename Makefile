# Every target prepares what it needs, on a machine where nothing but Python 3.11 or newer is installed.
.DEFAULT_GOAL := help
.PHONY: help setup explore fly ground test test-flights test-safety test-real mutants check-docker format

# A shell prepared for ROS or conda would bring its own packages along.
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV

ARGS =

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' Makefile

setup: ## prepare .venv and the system libraries; instant when nothing has changed
	@scripts/setup

explore: setup ## fly through a simulated mine into a new folder in runs/; options: ARGS="--help"
	@.venv/bin/companion sim --world complex $(ARGS)

fly: setup ## fly over MAVLink in real time: stub autopilot, world and application; options: ARGS="--help"
	@.venv/bin/companion sitl fly $(ARGS)

ground: setup ## see a map grow: fly over MAVLink and the link with the operator's page open; options: ARGS="--help"
	@.venv/bin/companion sitl ground $(ARGS)

test: setup ## format, lint, types, import contracts and tests; options for pytest: ARGS="-k config"
	@scripts/check $(ARGS)

test-flights: setup ## more whole flights over MAVLink, and other tests that `make test` leaves out for time
	@.venv/bin/pytest -n 2 -m "flight or long" $(ARGS)

test-safety: setup ## the fault matrix: each fault in a flight towards a wall; options: ARGS="--help"
	@.venv/bin/python -m validation.fault_matrix $(ARGS)

test-real: setup ## on the real PX4 and ArduCopter, where PX4_BINARY, ARDUCOPTER_BINARY name them, in a network of their own
	@scripts/own-network .venv/bin/pytest -p no:xdist -m real tests/real $(ARGS)

mutants: ## change the gate in small ways, and print the changes that no test notices: tens of minutes; ARGS="--quick gate.gate"
	@scripts/mutants $(ARGS)

check-docker: setup ## lint docker/; ARGS=--run also carries out its RUNs in a clean Debian, as root
	@scripts/check-docker $(ARGS)

format: setup ## sort the imports and format the code
	@.venv/bin/ruff check --quiet --select I --fix .
	@.venv/bin/ruff format .
