"""How well: answers, masks, edits and motion against what is true."""
