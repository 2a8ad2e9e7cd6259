"""The main job: compare a twin with measurements, learn which effect is missing, add it, compare."""

from lerobot_pneutac import Recording, add, calibrate, compare, diagnose
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.generate.finger import generate

# A finger with a hidden effect; the answer is in outputs/missing_effect/truth/, which nothing here opens.
generate("creep", "outputs/missing_effect/bench", seed=7, minutes=4, hz=10)

recording = Recording.load("outputs/missing_effect/bench")
twin = calibrate(new_twin(recording=recording), recording).twin
before = compare(twin, recording)
print(f"calibrated: {before.heldout:.2f} {before.unit} where the noise has {before.noise_floor:.2f}")

diagnosis = diagnose(twin, recording)
print(f"{diagnosis.verdict}: {diagnosis.sentence}")

result = add(twin, recording, diagnosis)  # stored where the test error falls significantly
print(f"{result.effect}: {'added' if result.accepted else 'refused'}. {result.sentence}")
twin = result.twin

after = compare(twin, recording)
print(f"with effects: {after.heldout:.2f} {after.unit}")
after.report("outputs/missing_effect/report")  # report.html in it opens offline
twin.save("outputs/missing_effect/twin")
