// One page, two uses: a report with its frames in it, and the live page of a running coordinator.
import { startLive } from "./live";
import { startReport } from "./report";

if (document.getElementById("pleat-live")) {
  startLive();
} else {
  void startReport();
}
