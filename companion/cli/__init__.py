"""The command `companion`: what people type, its options, its exit codes."""
