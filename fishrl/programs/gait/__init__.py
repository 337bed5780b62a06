"""Study of the Kármán gait: trials in every stream, diagnostics, tables and figures."""
