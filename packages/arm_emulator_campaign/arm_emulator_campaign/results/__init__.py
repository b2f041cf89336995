"""Results of a campaign: outcomes of runs, their files, summary, report and pictures."""
