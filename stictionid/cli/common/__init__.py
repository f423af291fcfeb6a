"""Parts that commands share: output, options for reading, study files, progress."""
