# `make demo` and `make test` do all the set-up they need, once, in .venv.
PYTHON ?= python3
# The index with the CPU build of torch, searched as well as PyPI, whose Linux build brings gigabytes of CUDA. Empty: PyPI only.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
WORKERS ?= 2

BIN := .venv/bin
READY := .venv/.installed
PIP := $(BIN)/python -m pip --disable-pip-version-check
TORCH := $(shell grep '^torch==' constraints.txt)
DEVKIT := .venv-devkit
PYTHONS ?= 3.12 3.13
# The tests of `make lowest` and `make pythons`: everything that a dependency is used in, in a quarter of an hour.
TOUCHING := tests/defenders tests/agents tests/cp_env
LIBRARIES := benchmarl rllib supersuit torchrl
ALONE = .venv-$*/bin/python -m pip install --disable-pip-version-check --quiet --retries 1
LEADERBOARD ?= --defenders none ego_only prbi prbi:threshold=calibrated robosac pasac:score=similarity bayes bayes:max_verifications=8 oracle \
	--attacks none pgd noise policy:name=prbi-stealth-action in_loop:steps=6 ramp:steps=6 nearest_removal critical_removal phantom_ahead \
	--seeds 0 1 --ks 2 1 4 --budgets 0.3 0.1 --off-baseline-attacks pgd --off-baseline-scenes 9 --n-scenes 21 --frames 40 --batch 7 \
	--screen town/calibration --screen-scenes 6 --precision bfloat16
export OMP_NUM_THREADS ?= 1

.PHONY: demo test lint mutants campaign lowest pythons $(PYTHONS:%=python-%) bench attacks devkit docs libraries $(LIBRARIES:%=library-%) ray leaderboard sumo record clean
.DEFAULT_GOAL := demo

demo: $(READY) ## the small benchmark: prints a table and writes out/demo/ with a video of one episode
	$(BIN)/cp-benchmark --small --out out/demo

test: $(READY) ## every test, on two workers
	$(BIN)/python -m pytest -n $(WORKERS) --benchmark-disable $(PYTEST_ARGS)

lint: $(READY) ## style, types, import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

mutants: $(READY) ## put hand-made mistakes into a copy of the tree: the tests must catch each; a quarter of an hour
	$(BIN)/python -m tests.mutants.run --workers $(WORKERS)

campaign: $(READY) ## kills, hostile inputs, a soak and more, for hours; goes on where it was stopped; writes docs/reliability.md
	$(BIN)/python -m tests.campaign.run --page docs/reliability.md

lowest: ## the tests with the lowest version of every dependency that pyproject.toml declares, in an environment of its own
	test -x .venv-lowest/bin/python || $(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python tests/project/lowest.py > .venv-lowest/lowest.txt
	.venv-lowest/bin/python -m pip install --disable-pip-version-check --quiet --retries 1 --no-deps $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) $(TORCH)
	.venv-lowest/bin/python -m pip install --disable-pip-version-check --quiet --only-binary :all: -r .venv-lowest/lowest.txt $(TORCH)
	.venv-lowest/bin/python -m pip install --disable-pip-version-check --quiet --no-deps -e .
	.venv-lowest/bin/python -m pytest -W default -m 'not slow' --benchmark-disable $(TOUCHING) $(PYTEST_ARGS)

pythons: $(PYTHONS:%=python-%) ## the tests under other versions of Python, each in an environment of its own

$(PYTHONS:%=python-%): python-%: ## one of these versions; its interpreter is python3.x, or one of pyenv's
	test -x .venv-$*/bin/python || $(firstword $(wildcard $(HOME)/.pyenv/versions/$*.*/bin/python) python$*) -m venv .venv-$*
	$(ALONE) --no-deps $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) $(TORCH)
	grep -v '^torch==' constraints.txt > .venv-$*/constraints.txt
	$(ALONE) -c .venv-$*/constraints.txt $(TORCH) -e '.[dev,agents,train,recurrent]'
	.venv-$*/bin/python -m pytest -m 'not slow' --benchmark-disable $(TOUCHING) $(PYTEST_ARGS)

bench: $(READY) ## speed, on one torch thread
	$(BIN)/python -m pytest benchmarks --benchmark-only --benchmark-columns=median,iqr,rounds

attacks: $(READY) ## our PGD and BIM against those of Foolbox: the same loss, and the speed of both
	$(PIP) install --quiet -c constraints.txt -e '.[attacks-check]'
	$(BIN)/python -m pytest tests/external/test_foolbox.py $(PYTEST_ARGS)
	$(BIN)/python -m pytest -s benchmarks/test_attacks.py -k foolbox

devkit: $(READY) ## load exported scenes in the nuScenes devkit, in an environment of its own (numpy < 2), and compare
	test -x $(DEVKIT)/bin/python || $(PYTHON) -m venv $(DEVKIT)
	$(DEVKIT)/bin/python -m pip install --disable-pip-version-check --quiet 'numpy<2' nuscenes-devkit==1.2.0
	$(BIN)/python -m tests.external.devkit.expected out/devkit
	$(DEVKIT)/bin/python tests/external/devkit/compare.py out/devkit

docs: ## the site, in out/site/, strict: no broken link, no page outside the menu; in an environment of its own
	test -x .venv-docs/bin/python || $(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --disable-pip-version-check --quiet -r docs/requirements.txt
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --quiet

libraries: $(LIBRARIES:%=library-%) ## train with other people's libraries, each in an environment of its own

$(LIBRARIES:%=library-%): library-%: tests/external/%.txt ## one of these libraries
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	$(ALONE) --no-deps $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) $(TORCH)
	$(ALONE) -r tests/external/$*.txt -e .
	.venv-$*/bin/python -m pytest -W default tests/external/test_$*.py

ray: $(READY) ## Ray, about 260 MB, to run the arena on a cluster: its tests are skipped without it
	$(PIP) install --quiet -c constraints.txt -e '.[ray]'

leaderboard: $(READY) ## run the arena on all test scenes and write docs/leaderboard.md; about four hours of one core
	$(BIN)/cp-arena $(LEADERBOARD) --workers $(WORKERS) --out out/leaderboard --page docs/leaderboard.md

sumo: $(READY) ## the traffic simulator, about 260 MB: its tests are skipped without it
	$(PIP) install --quiet -c constraints.txt -e '.[sumo]'

record: sumo ## record the traffic of town and junction again, in out/recordings
	$(BIN)/python -m cp_env.scenes.sumo.record --out out/recordings --jobs $(WORKERS)
	$(BIN)/python -m cp_env.scenes.sumo.record --regime junction --out out/recordings/junction --jobs $(WORKERS)

clean: ## remove the virtual environments
	rm -rf .venv $(DEVKIT) .venv-docs .venv-lowest $(PYTHONS:%=.venv-%) $(LIBRARIES:%=.venv-%)

# torch first, by its exact version and without its dependencies: an open range would prefer the CUDA build.
$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) install --quiet --retries 1 --no-deps $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) $(TORCH)
	$(PIP) install --quiet -c constraints.txt -e '.[dev,agents,train,recurrent]'
	touch $@
