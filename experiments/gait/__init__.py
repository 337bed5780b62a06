"""The Kármán gait, judged: who holds the station in which stream, how, and at what cost."""
