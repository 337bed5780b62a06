"""The lateral-line machine as a study: data, fits, what it can and cannot tell, and the report."""
