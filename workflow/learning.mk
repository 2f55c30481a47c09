# A move that is repeated is learned pass by pass, each drive from the recording of the last pass.
#
#     make -f workflow/learning.mk PLAY="python bench.py"
#
# It stops where the error grew. Nothing is kept between passes: the model and the last recording are all. Without --absolute
# the mean of the error is taken for the sensor's zero and left alone.

PLAY := python bench.py  # PLAY DRIVE -o RECORDING

learned: pass5.csv
.SECONDARY:

drive1.csv: model.json trajectory.csv
	dbo compensate model.json trajectory.csv -o $@

pass%.csv: drive%.csv
	$(PLAY) $< -o $@

drive%.csv: model.json trajectory.csv
	dbo compensate model.json trajectory.csv --absolute --tracked pass$$(($* - 1)).csv -o $@

drive2.csv: pass1.csv
drive3.csv: pass2.csv
drive4.csv: pass3.csv
drive5.csv: pass4.csv
