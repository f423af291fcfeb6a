"""Effects that users write in plain numpy: adapter, loader, contract test and template."""
