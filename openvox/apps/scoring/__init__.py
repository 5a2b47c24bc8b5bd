"""The measures of `evaluate`, one module each; docs/evaluation.md has the protocol in words."""
