"""What every wing draws and writes: figures of maps and routes, and Markdown."""
