# Everything runs in .venv, which `make setup` creates here. Needs make and Python 3.11 or newer.

# The demonstration: two Hoppers, calm and under standard-1; steps and number of the calm episodes.
DEMO_STEPS  ?= 20000
DEMO_SEEDS  ?= 3
DEMO_OUT    ?= demo
ifeq ($(strip $(DEMO_OUT)),)
$(error DEMO_OUT is empty; name a folder)
endif

# And at home: episodes of SetTable, release strategies, and the rolling resistance in [m] (0: only drag, as in Habitat,
# where the release strategies differ most; 0.0012 is the default).
DEMO_EPISODES ?= 4
DEMO_PLACES   ?= rl ik
DEMO_ROLLING  ?= 0

# Test processes, and further options of pytest: make test PYTEST="-k clock"
PROCESSES ?= 2
PYTEST    ?=

PYTHONS   ?= python3.11 python3.12 python3.13 python3
EXTRAS    ?= dev,docs,tensorboard,home,onnx
BIN       := .venv/bin
ONE_THREAD = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.DEFAULT_GOAL := help
.PHONY: help setup demo picture test check lint format verify docs bench clean

help: ## Show this list
	@sed -n 's/^\([a-z]*\):.*## /\1|/p' $(MAKEFILE_LIST) | while IFS='|' read -r target text; do \
		printf '  make %-8s %s\n' "$$target" "$$text"; done

# $(call install,ENVIRONMENT,WHAT pip INSTALLS): the fingerprint of what was installed is kept, so that the second time
# costs nothing.
define install
	@set -e; python=; \
	for each in $(PYTHONS); do \
		if $$each -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then python=$$each; break; fi; \
	done; \
	if [ -z "$$python" ]; then echo "perdure needs Python 3.11 or newer; none of $(PYTHONS) is one." >&2; exit 1; fi; \
	wanted="$(EXTRAS) $$($$python -c 'import hashlib; print(hashlib.sha256(open("pyproject.toml", "rb").read()).hexdigest())')"; \
	if [ "$$(cat $(1)/installed 2>/dev/null)" = "$$wanted" ] && [ -x $(1)/bin/python ]; then exit 0; fi; \
	echo "Installing into $(1) (once; minutes on a slow line)"; \
	if ! $(1)/bin/python -m pip --version >/dev/null 2>&1; then $$python -m venv $(1); fi; \
	$(2) | $(1)/bin/python -m pip install --quiet --disable-pip-version-check -r /dev/stdin; \
	echo "$$wanted" > $(1)/installed
endef

setup: ## Create .venv and install perdure into it (quick when nothing changed)
	$(call install,.venv,echo '-e .[$(EXTRAS)]')

demo: setup ## Run two shipped Hoppers, calm and disturbed, and two home demonstrations, and write the reports
	@set -ex; \
	$(BIN)/perdure demo --steps $(DEMO_STEPS) --eval-seeds $(DEMO_SEEDS) --out "$(DEMO_OUT)/Hopper-v3"; \
	{ set +x; } 2>/dev/null; \
	rm -rf "$(DEMO_OUT)/set_table/runs"; \
	for place in $(DEMO_PLACES); do \
		set -x; \
		$(BIN)/perdure home run set_table --place $$place --rolling $(DEMO_ROLLING) \
			--episodes $(DEMO_EPISODES) \
			--out "$(DEMO_OUT)/set_table/runs" >/dev/null; \
		{ set +x; } 2>/dev/null; \
	done; \
	set -x; \
	$(BIN)/perdure home analyze "$(DEMO_OUT)/set_table/runs" --out "$(DEMO_OUT)/set_table"; \
	{ set +x; } 2>/dev/null; \
	echo; echo "The reports, to be opened in a browser:"; \
	for task in Hopper-v3 set_table; do echo "  $(abspath $(DEMO_OUT))/$$task/report.html"; done

picture: ## Put the film and the figure of the disturbed Hoppers into README.md
	@cp "$(DEMO_OUT)"/Hopper-v3/hopper-v3-working-under-standard-1.png docs/images/demo-disturbed.png
	@rm -f docs/images/hoppers.webp
	@$(BIN)/perdure watch Hopper-v3/cured Hopper-v3/ppo --out docs/images/hoppers.webp

# A process runs whole files, in the order of tests/conftest.py; test_types.py and test_tree_rules.py check types and rules.
test: lint ## Check format and lint, then types, rules and every test but the long ones
	@$(ONE_THREAD) $(BIN)/python -m pytest -m "not verify" -n $(PROCESSES) --dist loadfile --no-loadscope-reorder $(PYTEST)

check: lint ## Check format, lint, types and rules, and report sizes beside main
	@$(BIN)/mypy
	@$(BIN)/python tools/rules.py

lint: setup
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .

format: setup ## Format the code, and fix what the linter can fix
	@$(BIN)/ruff check --fix --quiet . || true
	@$(BIN)/ruff format .

verify: EXTRAS := $(EXTRAS),verify
verify: setup ## Run the long checks
	@$(ONE_THREAD) $(BIN)/python -m pytest -m verify -n $(PROCESSES) --dist worksteal $(PYTEST)

docs: setup ## Build the documentation site into docs/_build/html; needs no network
	@$(BIN)/python -m sphinx -q -W --keep-going -b html -d docs/_build/doctrees docs docs/_build/html
	@echo "$(abspath docs/_build/html)/index.html"

PEERS = import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	print(*project["optional-dependencies"]["$(1)"], sep="\n")

bench: setup ## Measure beside the peers, in .venv-bench; writes benchmarks/latest.json
	$(call install,.venv-bench,$(BIN)/python -c '$(call PEERS,bench)')
	$(call install,.venv-bench-robotics,$(BIN)/python -c '$(call PEERS,bench-robotics)')
	@$(BIN)/python benchmarks/bench.py

clean: ## Remove caches, build products and the demonstration; keep .venv and runs
	@rm -rf build dist docs/_build docs/reference/api docs/reference/cli.md docs/reference/contract.md docs/home/skills.md "$(DEMO_OUT)" .pytest_cache .mypy_cache .ruff_cache .hypothesis src/*.egg-info
	@find src studies tests benchmarks examples tools -name __pycache__ -type d -prune -exec rm -rf {} +
