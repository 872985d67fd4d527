# Two commands do everything: `make fly` and `make test`. Both set the environment up first when it is missing.
SETUP := .setup/ready-$(shell cat requirements.lock pyproject.toml .ci/setup | cksum | cut -d' ' -f1)
BIN := .venv/bin
MISSION ?= missions/bridge.toml
ARGS ?=

.PHONY: fly test lint unit doctor setup clean

fly: $(SETUP)
	$(BIN)/swarmscan fly $(MISSION) $(ARGS)

test: lint unit

setup: $(SETUP)

$(SETUP):
	bash .ci/setup
	@mkdir -p .setup && rm -f .setup/ready-* && touch $@

lint: $(SETUP)
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

unit: $(SETUP)
	$(BIN)/pytest -n $(or $(TEST_WORKERS),auto) --dist loadgroup

doctor: $(SETUP)
	$(BIN)/swarmscan doctor

clean:
	rm -rf .venv .setup .mypy_cache .ruff_cache .pytest_cache .hypothesis
