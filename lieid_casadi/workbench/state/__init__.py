"""What a page shows and saves: inputs, history, proposals."""
