# Thin: every target is one command that also works alone.
.PHONY: setup demo test check format contract lock

setup:
	@tools/setup

demo: setup
	@.venv/bin/eigenscan demo $(if $(HEADLESS),--headless)

check: setup
	@tools/check

test: setup
	@tools/test

format: setup
	@.venv/bin/ruff format . && .venv/bin/ruff check --fix .

contract: setup
	@tools/generate-contract

lock: setup
	@tools/lock
