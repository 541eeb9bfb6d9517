"""The contract between services: messages, keys, quality of service."""
