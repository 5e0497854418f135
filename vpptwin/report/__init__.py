"""What is told: verdict.json, the extended twin, the page, predictions as logs, and the lines in the terminal."""
