# Thin: every target is one command that also works alone.
.PHONY: setup demo test test-all check format contract lock

setup:
	@tools/setup

demo: setup
	@viewer=; test -t 1 || viewer=--headless; .venv/bin/eigenscan demo $(if $(HEADLESS),--headless,$$viewer)

check: setup
	@tools/check

test: setup
	@tools/test

test-all: setup
	@tools/test --all

format: setup
	@.venv/bin/ruff format . && .venv/bin/ruff check --fix .

contract: setup
	@tools/generate-contract

lock: setup
	@tools/lock
