"""Pictures: Rerun, and images drawn without a screen."""
