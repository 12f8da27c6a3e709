"""What a user sees while jobs run: how far each stage is, how long the rest may take, and at last what failed."""
