# A fresh machine needs Python >= 3.12 and make. uv is fetched with pip where it is missing.
PYTHON ?= python3
UV := $(shell uv --version >/dev/null 2>&1 && echo uv || echo .uv/bin/uv)
BIN := .venv/bin
# A command starts in a third of the time where its modules are compiled once and kept.
unexport PYTHONDONTWRITEBYTECODE
# A file of tests stays in one process; each process computes on one thread, so that they share the cores. Three on
# two cores: some tests record at the pace of the clock, while the cores would idle.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses=3 --dist=loadfile --no-loadscope-reorder --durations=25
# Tests of the real clock: alone, one process a core, for they mostly wait.
REALTIME = OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses=2 --dist=loadfile -m "realtime and not nightly" \
	$$(grep -rl --include="test_*.py" mark.realtime tests)

.PHONY: demo check lint test nightly bench docs hub-dry-run sbom

demo: .venv/ready
	$(BIN)/pneutac demo

# Before every commit: two minutes on two cores.
check: lint
	$(PYTEST) -m "not slow and not nightly and not realtime"

# Everything that CI runs: 17 minutes on two cores, more beside other work.
test: .venv/ready
	$(PYTEST) -m "not nightly and not realtime"
	$(REALTIME) || $(REALTIME) --last-failed

# What is too long for CI; with MuJoCo Warp, whose worlds are compared with the single one.
nightly: .venv/ready
	$(UV) pip install -q --python $(BIN)/python -e '.[dev,warp]' -c constraints.txt
	$(PYTEST) -m nightly

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache --no-logo
	$(BIN)/deptry --no-ansi .
	cd robots && ../$(BIN)/deptry --no-ansi .
	cd packages/lerobot_camera_digit && ../../$(BIN)/deptry --no-ansi .
	$(BIN)/pyright --project pyproject.toml --pythonpath $(BIN)/python

docs: .venv/ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# A dataset and a policy in outputs/hub, as they would be pushed.
hub-dry-run: .venv/ready
	HF_HUB_OFFLINE=1 $(BIN)/python examples/hub_dry_run.py

# What is installed, with versions and licences, as CycloneDX.
sbom: .venv/ready
	$(UV) tool run --from cyclonedx-bom==7.5.0 cyclonedx-py environment --pyproject pyproject.toml \
		--mc-type application --output-reproducible -o sbom.json $(BIN)/python

bench: .venv/ready
	for f in benchmarks/*_speed.py; do $(BIN)/python $$f || exit 1; done

.venv/ready: pyproject.toml robots/pyproject.toml packages/lerobot_camera_digit/pyproject.toml constraints.txt
	@[ "$(UV)" = uv ] || [ -x $(UV) ] || { $(PYTHON) -m venv .uv && .uv/bin/python -m pip install -q uv; }
	$(UV) venv -q --allow-existing --python 3.12 .venv
	$(UV) pip install -q --python $(BIN)/python -e '.[dev]' -c constraints.txt
	@ln -sf "$$(realpath "$$(command -v $(UV))")" $(BIN)/uv
	@touch $@
