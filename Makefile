# Two commands do everything: `make fly` and `make test`. Both set the environment up first when it is missing.
SETUP := .setup/ready-$(shell cat requirements.lock pyproject.toml .ci/setup | cksum | cut -d' ' -f1)
BIN := .venv/bin
MISSION ?= missions/bridge.toml
ARGS ?=

.PHONY: fly test lint unit doctor setup compile clean

fly: compile
	$(BIN)/swarmscan fly $(MISSION) $(ARGS)

test: lint unit

setup: compile

$(SETUP):
	bash .ci/setup
	@mkdir -p .setup && rm -f .setup/ready-* && touch $@

# Numba caches by file and time: a changed kernel compiles here, not while a mission flies or in every test process.
compile: $(SETUP)
	@bash .ci/compile

lint: $(SETUP)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

unit: compile
	@bash .ci/browser
	$(BIN)/pytest -n $(or $(TEST_WORKERS),auto) --dist loadgroup

doctor: $(SETUP)
	$(BIN)/swarmscan doctor

clean:
	rm -rf .venv .setup .mypy_cache .ruff_cache .pytest_cache .hypothesis
