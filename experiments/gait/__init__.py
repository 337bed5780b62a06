"""Kármán gait: trials in every stream, diagnostics, tables and figures."""
