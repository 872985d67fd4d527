"""The tester of next-best-view methods: the truth that their choices are judged by."""
