"""Conformance: any program in a service's place is played the contract's vectors over Zenoh, and judged."""
