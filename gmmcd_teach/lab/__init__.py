"""The simulated Granite Lab and the real table-top pairs (chapter 1)."""
