"""Arms of servos, identified from commands and positions by simulating them in MuJoCo."""

from dynident.apps.servo.check import examine_servos
from dynident.apps.servo.predict import predict_servos, rollout_frame
from dynident.apps.servo.report import (
    MODEL,
    NUMBERS,
    PAGE,
    identify_servos,
    parameter_table,
    rollout_table,
    servo_dict,
    servo_page,
    suspect_lines,
    verdict_words,
)
from dynident.apps.servo.result import ServoIdentification
from dynident.apps.servo.run import fit_servos, read_servo_logs
from dynident.apps.servo.saved import load_servo_result
