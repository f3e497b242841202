"""What is said in the end: the verdict, its report, the next motion."""
