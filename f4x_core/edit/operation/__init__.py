"""The operations of edit stacks, one file each; `edit.operations` has their names and finds every file here."""
