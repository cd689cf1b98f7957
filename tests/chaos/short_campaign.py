"""Campaign of the fast chaos tests: one short run with a replay buffer and an adaptive teacher."""

from dataclasses import replace

from chaos_campaign import CAMPAIGN
from small_runs import STUDENTS

CELL = replace(CAMPAIGN.cells[0], student="sac", student_hyperparameters=STUDENTS["sac"])
SHORT = replace(CAMPAIGN, cells=(CELL,), schedule=replace(CAMPAIGN.schedule, steps=1_500))

if __name__ == "__main__":
    SHORT.main()
