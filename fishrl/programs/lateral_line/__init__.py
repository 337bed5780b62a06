"""Study of the lateral line: data, fits of classifiers, questions, and the report."""
