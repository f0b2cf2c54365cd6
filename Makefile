# Every target makes .venv by itself. A machine with Python 3.11 to 3.13, make and git is enough; uv is used if present.
# Another interpreter: make PYTHON=python3.12 test. More or fewer test processes: make TEST_PROCESSES=8 test.

PYTHON ?=
OUT ?= out
TEST_PROCESSES ?= 2
BIN := .venv/bin
RUN := $(BIN)/python -m
# A file of tests runs in one process: what its tests compile is compiled once. (With pytest 9.2 xdist 3.8 heeds no groups.)
# The longest files begin (tests/conftest.py).
PYTEST := pytest -n $(TEST_PROCESSES) --dist loadfile --no-loadscope-reorder
INSTALLED := .venv/.installed
PEERS := .venv/peers
NEWEST := .venv/newest
LOWEST := .venv/lowest

.PHONY: help demo test quick versions hostile nightly ivp load loop native platforms check format fmu bench chart atlas planning jobs effects identification levels pictures docs dist clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' Makefile

demo: $(INSTALLED)  ## build the FMU, run it and write report, pictures and tables to out/
	$(BIN)/crane-fmu demo -o "$(OUT)"

test: $(INSTALLED)  ## run the test suite (some seven minutes)
	$(RUN) $(PYTEST)

quick: $(INSTALLED)  ## run a short case of most tests, and more for the modules that have changed (about a minute)
	$(RUN) $(PYTEST) --quick -q

versions: $(NEWEST)/.installed $(LOWEST)/.installed  ## run the tests on Python 3.13 with the newest releases, on 3.11 with the lowest allowed
	@status=0; try() { echo "In $$1:"; \
		"$$1/bin/python" -c "import sys, casadi, numpy, scipy; print('Python', sys.version.split()[0], 'CasADi', \
		casadi.__version__, 'NumPy', numpy.__version__, 'SciPy', scipy.__version__)"; \
		"$$1/bin/python" -m $(PYTEST) -p no:cacheprovider $$2 || status=1; }; \
	try $(NEWEST); try $(LOWEST) "-W ignore::DeprecationWarning"; exit $$status

hostile: $(INSTALLED)  ## ask each FMU ten thousand random sequences of calls (some 15 minutes)
	SERVOCORE_HOSTILE_SEQUENCES=10000 $(RUN) pytest -s --durations=0 tests/test_hostile.py

nightly: $(INSTALLED)  ## run what takes minutes, five hundred random mechanisms, property tests with a fresh seed (an hour)
	@status=0; seed=$${SEED:-$$(date +%s)}; again() { echo "The seed was $$seed: make nightly SEED=$$seed"; status=1; }; \
	$(RUN) $(PYTEST) --most-of-budget 2 || status=1; \
	$(RUN) $(PYTEST) --nightly -m nightly || status=1; \
	SERVOCORE_MECHANISMS=500 $(RUN) pytest -n $(TEST_PROCESSES) tests/outside/test_random_mechanisms.py \
		tests/outside/test_random_trees.py || status=1; \
	echo "Property tests with the seed $$seed"; \
	$(RUN) pytest -n $(TEST_PROCESSES) -m hypothesis --hypothesis-profile=fresh --hypothesis-seed=$$seed || again; \
	exit $$status

ivp: $(PEERS)/.installed  ## measure problems of the test set of Bari beside scipy_dae and IDA, into docs/ivp-test-set.md
	$(PEERS)/bin/python -m benchmarks.ivp

load: $(INSTALLED)  ## 200 instances and a million steps: memory must not grow
	SERVOCORE_LOAD=full $(RUN) pytest -s --durations=0 tests/test_load.py

loop: $(INSTALLED)  ## close the loop of native inverse model and plant over 200 random manoeuvres at every step (an hour)
	$(BIN)/python tests/loop_study.py

native: $(INSTALLED)  ## export every scene for FMI 2 and 3, run and compare all; fourteen thousand hostile sequences (some minutes)
	SERVOCORE_NATIVE=full $(RUN) $(PYTEST) --nightly -s --durations=0 tests/test_export_hosts.py tests/test_export.py \
		tests/test_export_system.py tests/test_export_derivatives.py tests/test_export_wasm.py tests/test_hostile.py \
		tests/test_fmi_rules.py tests/test_foreign_tools.py

platforms: $(INSTALLED)  ## run exported libraries of other platforms: needs ziglang, and Wine or QEMU (minutes at first)
	SERVOCORE_PLATFORMS=all $(RUN) pytest -s --durations=0 -n 0 -k "platforms or linux or macos" tests/test_export_hosts.py

check: $(INSTALLED)  ## lint, format, types, direction of the imports, docstrings, links of pages: all, then fail if one did
	@status=0; run() { echo "$$@"; "$$@" || status=1; }; \
	run $(RUN) ruff check .; run $(RUN) ruff format --check .; run $(RUN) mypy --strict; run $(RUN) mypy --strict tests examples docs build_fmu.py; \
	run $(BIN)/lint-imports; \
	run $(BIN)/python tests/docstrings.py; \
	run $(RUN) pytest -q -p no:cacheprovider tests/check_project.py; \
	exit $$status

format: $(INSTALLED)  ## apply the formatter and the linter's safe corrections
	$(RUN) ruff check --fix .
	$(RUN) ruff format .

fmu: $(INSTALLED)  ## build the rotary crane's FMU
	$(BIN)/python build_fmu.py

bench: $(INSTALLED)  ## measure what steps, FMUs and WebAssembly cost on this machine, and how cost grows with size
	$(RUN) pytest benchmarks/test_bench_steps.py --benchmark-enable --benchmark-timer=time.process_time \
		--benchmark-columns=median,iqr,rounds -q
	$(BIN)/python benchmarks/step_cost.py
	$(BIN)/python benchmarks/fmu_cost.py
	$(BIN)/python benchmarks/native_cost.py
	$(RUN) benchmarks.step_times
	$(BIN)/python benchmarks/wasm_cost.py
	OMP_NUM_THREADS=1 $(RUN) benchmarks.size_cost
	$(BIN)/python benchmarks/energy_momentum.py

chart: $(PEERS)/.installed  ## measure speed and accuracy beside other solvers, into docs/speed-accuracy (a quarter of an hour)
	$(PEERS)/bin/python -m benchmarks.chart

atlas: $(INSTALLED)  ## measure how integration fails and what survives, into docs/stability (some ten minutes)
	$(RUN) benchmarks.atlas

planning: $(INSTALLED)  ## plan fourteen manoeuvres within limits, into docs/planning (two minutes)
	$(RUN) benchmarks.planning

jobs: $(INSTALLED)  ## plan a hundred random manoeuvres, into docs/planning (some ten minutes)
	$(RUN) benchmarks.planning.jobs
	$(RUN) benchmarks.planning.more_jobs

effects: $(INSTALLED)  ## compare estimates of left out effects with simulations, into docs/effects (some ten minutes)
	$(RUN) benchmarks.effects

identification: $(PEERS)/.installed  ## identify random cranes from synthetic logs, into docs/identification (half an hour)
	$(PEERS)/bin/python -m benchmarks.identification

docs: $(INSTALLED)  ## write the site with API reference and gallery to build/docs, run its examples and notebooks (three minutes)
	MPLBACKEND=Agg $(RUN) sphinx -W --keep-going -q -b html docs build/docs
	$(BIN)/python docs/run_notebooks.py
	MPLBACKEND=Agg $(RUN) sphinx -W --keep-going -q -b doctest -d build/docs/.doctrees docs build/doctest
	@echo "The site is build/docs/index.html."

dist: $(INSTALLED)  ## build wheel and source distribution into dist/
	rm -rf dist
	$(RUN) build --outdir dist .

levels: $(INSTALLED)  ## measure what the models of every scene cost, into docs/model-levels.md (two minutes)
	$(RUN) benchmarks.levels --page docs/model-levels.md --csv docs/model-levels.csv

pictures: $(INSTALLED)  ## draw the pictures of the documentation again
	$(BIN)/python docs/make_pictures.py
	$(BIN)/python docs/draw_certificate.py
	$(BIN)/python docs/draw_elastic_arm.py
	$(BIN)/python docs/draw_icon.py
	$(BIN)/python docs/draw_live_page.py

clean:  ## remove everything that was made but .venv
	rm -rf build dist docs/gallery docs/api/generated docs/sg_execution_times.rst "$(OUT)" .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .benchmarks *.fmu
	find servocore crane_fmu tests benchmarks docs examples -name __pycache__ -prune -exec rm -rf {} +

# The environment. It is made once and brought up to date when pyproject.toml changes.

SUITABLE = import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))

$(INSTALLED): pyproject.toml | $(BIN)/python
	@echo "Installing servocore and its tools into .venv (about a minute)"
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -e '.[all,dev]'; \
	else $(RUN) pip install --quiet --disable-pip-version-check -e '.[all,dev]'; fi
	@if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(BIN)/python -e '.[all,dev,masters]'; \
	else $(RUN) pip install --quiet --disable-pip-version-check -e '.[all,dev,masters]'; fi >/dev/null 2>&1 \
	|| echo "Not all of ecospy, libcosimpy and fmu-manipulation-toolbox can be installed here; their tests are skipped"
	@touch $@

# Other solvers have an environment of their own: they must not change the versions that the tests run with.
$(PEERS)/.installed: pyproject.toml | $(INSTALLED)
	@echo "Installing other solvers into $(PEERS) (a minute or two)"
	@if command -v uv >/dev/null 2>&1; then uv venv --quiet --clear --python $(BIN)/python $(PEERS); \
	else $(RUN) venv $(PEERS); fi
	@install() { if command -v uv >/dev/null 2>&1; then uv pip install --quiet --python $(PEERS)/bin/python "$$@"; \
	else $(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check "$$@"; fi; }; \
	install -e . || exit 1; \
	for each in $$($(BIN)/python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']\
	['optional-dependencies']['peers'])"); do \
		install "$$each" >/dev/null 2>&1 || echo "$$each cannot be installed here; the page says so"; \
	done
	@touch $@

# Both ends of what pyproject.toml allows. Only uv can look for the lowest releases; where it is not there it gets an
# environment of its own. An interpreter that the machine lacks is fetched by uv. What our dependencies depend on is new in
# both: there the lowest releases use what has been deprecated since, which is not ours to mend.
$(NEWEST)/.installed: version = 3.13
$(NEWEST)/.installed: resolution = highest
$(LOWEST)/.installed: version = 3.11
$(LOWEST)/.installed: resolution = lowest-direct
$(NEWEST)/.installed $(LOWEST)/.installed: pyproject.toml | $(INSTALLED)
	@echo "Installing servocore and its tools into $(@D), Python $(version), resolution $(resolution) (a minute or two)"
	@set -eu; uv=$$(command -v uv || echo .venv/uv/bin/uv); \
	if ! command -v "$$uv" >/dev/null 2>&1; then \
		$(RUN) venv .venv/uv; .venv/uv/bin/python -m pip install --quiet --disable-pip-version-check uv; fi; \
	"$$uv" venv --quiet --clear --python $(version) $(@D); \
	"$$uv" pip install --quiet --python $(@D)/bin/python --resolution $(resolution) -e '.[all,dev]'
	@touch $@

$(BIN)/python:
	@set -eu; \
	for each in $(or $(PYTHON),python3 python3.13 python3.12 python3.11); do \
		if "$$each" -c '$(SUITABLE)' 2>/dev/null; then python=$$each; break; fi; \
	done; \
	if [ -z "$${python:-}" ]; then \
		echo "servocore needs Python 3.11, 3.12 or 3.13; found no such $(or $(PYTHON),python3)." \
			"Name one with: make PYTHON=python3.12" >&2; exit 1; \
	fi; \
	echo "Making .venv with $$("$$python" --version)"; \
	if command -v uv >/dev/null 2>&1; then uv venv --quiet --python "$$python" .venv; \
	else "$$python" -m venv .venv || { rm -rf .venv; \
		echo "Python's venv module does not work here; Debian and Ubuntu have it as python3-venv." >&2; exit 1; }; fi
