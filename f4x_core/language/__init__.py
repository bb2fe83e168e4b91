"""English that edits and questions share: words, numbers, times, amounts, directions, colours, and how sentences are matched."""
