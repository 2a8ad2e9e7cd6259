# A fresh machine needs Python >= 3.12 and make. uv is fetched with pip where it is missing.
PYTHON ?= python3
UV := $(shell uv --version >/dev/null 2>&1 && echo uv || echo .uv/bin/uv)

.PHONY: demo test lint bench

demo: .venv/ready
	.venv/bin/pneutac demo

# A file of tests stays in one process; each process computes on one thread, so that they share the cores.
test: .venv/ready
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest --numprocesses=auto --maxprocesses=4 --dist=loadfile --no-loadscope-reorder

lint: .venv/ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

bench: .venv/ready
	for f in benchmarks/*_speed.py; do .venv/bin/python $$f || exit 1; done

.venv/ready: pyproject.toml constraints.txt
	@[ "$(UV)" = uv ] || [ -x $(UV) ] || { $(PYTHON) -m venv .uv && .uv/bin/python -m pip install -q uv; }
	$(UV) venv -q --allow-existing --python 3.12 .venv
	$(UV) pip install -q --python .venv/bin/python -e '.[dev]' -c constraints.txt
	@ln -sf "$$(realpath "$$(command -v $(UV))")" .venv/bin/uv
	@touch $@
