import "../common/style.css";
import "../common/page";
